# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Thresholds that several families of rules share; all others are next to their rule."""

from msg_defs.nanoseconds import NS_PER_S

WINDOW_S = 10.0                    # what is older says nothing of now
WINDOW_NS = int(WINDOW_S * NS_PER_S)
BLUR_FACTOR = 3                    # times the resolution: what is narrower is not a finding
INCIDENTS_MIN = 3                  # that show a cause: one or two of a kind happen by chance
GONE_S = 1.5                       # unanswered for so long: gone, rather than starting again
SUPPLY_MIN_DEVICES = 3             # as many have the same trouble: it is their supply
DIP_MAX_SHARE = 0.9                # share of the voltage: lower before, and the supply sagged
STILL_MIN_REPORTS = 6              # at rest in so many reports: it is not on its way
TURN_STEPS = 4096                  # in models of X and MX (e-Manual)
STILL_MAX_STEPS = 6                # a joint that holds its place is read within so many
GOAL_MOVES_STEPS = 20              # a goal that changes less may be held by friction
GOAL_FAR_STEPS = 200               # farther than what holds a joint bends
ADAPTER_HOLD_US = 20_000           # so long an adapter may hold an answer back (latency timer)
LONG_WAIT_MS = 50                  # a time-out that no sound servo and adapter needs
SPEED_MIN = 10                     # units of Goal Velocity; friction may hold less
