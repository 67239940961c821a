# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Both nodes on the kernel's own serial drivers: a Debian guest and what is plugged into it.

`image` builds its disk once, `guest` boots it and plugs adapters, `lead` connects them to the
fakes on this machine, `inside/` holds the programs that run in the guest. `check_*.py` are the
checks; the name of each is the sentence that it shows. `scripts/test-drivers` runs them.
"""
