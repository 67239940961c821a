# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Symptoms: what is seen of a bus, by which a finding that follows from another one is recognised.

A rule says which symptoms its findings have, and which it accounts for. A finding is not reported
where another one accounts for all its symptoms (rules.accounts_for).
"""

from __future__ import annotations

from collections.abc import Set
from typing import get_args
from typing import Literal

# How bytes, packets and answers come: at a wrong rate, or with an echo, none of that is real.
TrafficSymptom = Literal[
    'echo', 'lost bytes', 'stray bytes', 'unread bytes', 'damaged first bytes',
    'damaged answers',               # from one device
    'damaged packets',               # from several
    'missed answers',                # now and then
    'silent device', 'silent bus',
    'device not served',             # in a group read that ends at a silent device before it
    'answers to Pings only',
    'absence',                       # silent for a moment, and back
    'absence of several', 'restart',
    'second answers', 'unasked answers', 'late answers', 'wrong length', 'no acknowledgements',
    'unanswered group reads',
    'hasty instructions',            # before an answer is over
    'two rhythms', 'uneven rhythm', 'slow answers', 'busy line', 'slow cycle', 'no writes']
# What packets, writes and registers say.
ContentSymptom = Literal[
    'no packets', 'two protocols', 'changed rate', 'unsent instructions', 'refused access',
    'refused address', 'refused value', 'error bits', 'voltage limit', 'joint at rest',
    'proof']                         # it shows the cause itself: nothing else accounts for that
Symptom = TrafficSymptom | ContentSymptom

TRAFFIC: Set[Symptom] = frozenset(get_args(TrafficSymptom))
PROOF: Set[Symptom] = frozenset({'proof'})
# What follows from many causes.
SILENCE: Set[Symptom] = frozenset({
    'silent device', 'device not served', 'missed answers', 'uneven rhythm'})
DAMAGE: Set[Symptom] = frozenset({
    'damaged packets', 'damaged answers', 'missed answers', 'absence', 'stray bytes',
    'uneven rhythm'})
