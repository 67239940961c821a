// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Light or dark, before anything is drawn: the last choice made here, or else the system's.
(() => {
  const root = document.documentElement;
  const dark = matchMedia('(prefers-color-scheme: dark)');
  let chosen = null;
  try { chosen = localStorage.getItem('theme'); } catch { /* no storage: the system decides */ }
  const paper = matchMedia('print');
  const apply = () => {
    root.dataset.theme = paper.matches ? 'light' : chosen ?? (dark.matches ? 'dark' : 'light');
    window.dispatchEvent(new Event('theme'));      // plots are pixels: they are drawn again
  };
  for (const query of [dark, paper]) query.addEventListener('change', apply);
  apply();
  window.toggleTheme = () => {
    chosen = root.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('theme', chosen); } catch { /* for this visit only */ }
    apply();
  };
})();
