# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""What `servobus.listen` costs a program: CPU time of an exchange, its part of reports too."""
from contextlib import nullcontext
from functools import partial
import time

from serial.urlhandler.protocol_loop import Serial

from msg_defs.dxl_instruction import Instruction
from msg_defs.dxl_packet import encode
from msg_defs.dxl_packet import STATUS
from rigs.harness import Figure
from rigs.harness import interleaved
from servobus import listen
from servobus import Models

SERVOS = range(1, 7)
EXCHANGES, QUICK_EXCHANGES = 3000, 600
QUESTIONS = [encode(number, Instruction.READ, bytes((132, 0, 4, 0))) for number in SERVOS]
ANSWERS = [encode(number, STATUS, bytes(4), error=0) for number in SERVOS]


class Servos(Serial):
    """A port on which each question is answered at once."""

    def write(self, data):
        self._answer = ANSWERS[data[4] - 1]
        return len(data)

    def read(self, size=1):
        answer, self._answer = self._answer, b''
        return answer

    @property
    def in_waiting(self):
        return 0


def run(options):
    """Measure a program with and without `listen`."""
    models = Models()
    count = QUICK_EXCHANGES if options.quick else EXCHANGES
    results = interleaved({'alone': partial(_exchange_us, count, None),
                           'heard': partial(_exchange_us, count, models)}, options.rounds)
    added = [heard - alone for heard, alone in zip(results['heard'], results['alone'],
                                                   strict=True)]
    return [Figure('library', 'added to an exchange, its part of the reports too', 'us', added)]


def _exchange_us(count, models):
    port = Servos('loop://')
    began = time.process_time_ns()
    with nullcontext() if models is None else listen(port, models=models):
        for at in range(count):
            port.write(QUESTIONS[at % len(QUESTIONS)])
            port.read(15)
    return (time.process_time_ns() - began) / 1e3 / count
