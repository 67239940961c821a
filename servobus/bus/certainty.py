# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
How certain it is that an answer belongs to the pending instruction; one table.

The tracker is always in one of these states, and each instruction begins in SURE. Only here is it
decided what damage does to that.
"""

SURE = 0           # nothing was damaged since the instruction
CUT = 1            # a fast reply broke off after a whole part: its rest may come as noise
SPOILT = 2         # damage on the way to the master: an answer may be lost, none is mistaken
DOUBTFUL = 3       # damage that may have hidden another instruction: an answer proves life only

DAMAGE = 0         # a damaged frame, or noise in front of one
NOISE = 1          # more than a glitch of it, in front of a good frame
BROKE_OFF = 2      # a fast reply ended after a whole part
# Where the side is known and it is that to the master, no instruction can be hidden.
DAMAGE_IN = 3
NOISE_IN = 4
ON_THE_WIRE, TO_MASTER = (DAMAGE, NOISE), (DAMAGE_IN, NOISE_IN)

#            DAMAGE    NOISE     BROKE_OFF DAMAGE_IN NOISE_IN
NEXT = {
    SURE:     (DOUBTFUL, DOUBTFUL, CUT, SPOILT, SPOILT),
    CUT:      (DOUBTFUL, SURE, CUT, SPOILT, SURE),
    SPOILT:   (DOUBTFUL, DOUBTFUL, SPOILT, SPOILT, SPOILT),
    DOUBTFUL: (DOUBTFUL, DOUBTFUL, DOUBTFUL, DOUBTFUL, DOUBTFUL),
}
