# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The node dxl_monitor as it would be without its reader process: a thread of it reads."""

from functools import partial
import sys
from unittest import mock

from dxl_monitor.start import main
from servobus import monitored_bus

# Fails where monitored_bus.py no longer has that name; an assignment would go unseen.
in_thread = mock.patch.object(monitored_bus, 'listener_on',
                              partial(monitored_bus.listener_on, in_thread=True))

if __name__ == '__main__':
    with in_thread:
        sys.exit(main())
