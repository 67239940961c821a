# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The node dxl_monitor as it would be without its reader process: a thread of it reads."""

from functools import partial
import sys

from dxl_monitor import node
from dxl_monitor.main import main

if __name__ == '__main__':
    node.Listener = partial(node.Listener, in_thread=True)      # type: ignore[misc, assignment]
    sys.exit(main())
