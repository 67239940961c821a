# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The dashboard: a web page that shows what both nodes publish, and a small server for it."""
