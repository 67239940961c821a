// Copyright 2026 The mecarover_serial authors
// SPDX-License-Identifier: Apache-2.0
// Light or dark, before anything is drawn: the last choice made here, or else the system's.
(() => {
  const root = document.documentElement;
  const dark = matchMedia('(prefers-color-scheme: dark)');
  let chosen = null;
  try { chosen = localStorage.getItem('theme'); } catch { /* no storage: the system decides */ }
  const apply = () => { root.dataset.theme = chosen ?? (dark.matches ? 'dark' : 'light'); };
  dark.addEventListener('change', apply);
  apply();
  window.toggleTheme = () => {
    chosen = root.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('theme', chosen); } catch { /* for this visit only */ }
    apply();
    window.dispatchEvent(new Event('theme'));
  };
})();
