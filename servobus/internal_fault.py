# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""An exception that is a mistake of ours: it is logged, and the program goes on without it."""

import logging
import traceback

LOG = logging.getLogger('mecarover_serial')
_logged: set[tuple[str, int]] = set()


def survive(what: str, mistake: Exception) -> None:
    """Log an exception with its traceback, once for each place in the code that raises it."""
    place = '', 0
    for frame, line in traceback.walk_tb(mistake.__traceback__):
        place = frame.f_code.co_filename, line
    if place not in _logged:
        LOG.error('internal error in %s, which continues; please report '
                  'it', what, exc_info=mistake)
        _logged.add(place)
