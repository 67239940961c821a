# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""Three ways to have a serial port in the guest, each with the driver that a robot would use."""
from __future__ import annotations

from rigs.drivers.guest import INSIDE
from rigs.drivers.lead import Lead


class Adapter:
    """A port at `path` in the guest, with a fake at its far end while it is plugged in."""

    path = ''
    driver = ''

    def __init__(self, guest, fake, *, gather):
        self.lead = None
        self.handed = 0             # bytes that came to the fake, over all leads until now
        self._guest = guest
        self._fake = fake
        self._gather = gather

    def __enter__(self):
        self.plug()
        return self

    def __exit__(self, *_):
        self.unplug()

    def plug(self):
        """Plug it in, and wait until udev has given it its name and its rights."""
        raise NotImplementedError

    def unplug(self):
        """Pull it out; the bytes on their way are lost."""
        raise NotImplementedError

    def _connect(self, socket):
        self.lead = Lead(socket, self._fake, gather=self._gather)

    def _disconnect(self):
        if self.lead is not None:
            self.lead.__exit__()
            self.handed += self.lead.handed
        self.lead = None

    def _wait_node(self):
        self._guest.wait(f'[ "$(stat -Lc %G {self.path})" = dialout ]')


class Ftdi(Adapter):
    """An FTDI adapter on USB."""

    driver = 'ftdi_sio'

    def __init__(self, guest, fake, *, gather, serial='FT4TFSGE'):
        super().__init__(guest, fake, gather=gather)
        self._serial = serial
        self.path = f'/dev/serial/by-id/usb-QEMU_QEMU_USB_SERIAL_{serial}-if00-port0'

    def plug(self):
        self._connect(self._guest.plug(self._serial, serial=self._serial))
        self._wait_node()

    def unplug(self):
        self._disconnect()
        self._guest.unplug(self._serial)


class Uart(Adapter):
    """A 16550, on a card that can be pulled out."""

    driver = 'serial'
    path = '/dev/ttyS2'         # the first name without a UART; it is there before and after

    def plug(self):
        self._connect(self._guest.plug('card', 'pci-serial'))
        self._guest.wait('[ "$(cat /sys/class/tty/ttyS2/type)" != 0 ]')
        self._wait_node()

    def unplug(self):
        self._disconnect()
        self._guest.unplug('card')


class Acm(Adapter):
    """A board with USB of its own: a gadget in the guest, plugged into the guest itself."""

    driver = 'cdc_acm'
    path = '/dev/ttyACM0'

    def __init__(self, guest, fake, *, gather):
        super().__init__(guest, fake, gather=gather)
        self.board = None

    def plug(self):
        self._guest.run('modprobe g_serial')
        self._connect(self._guest.gadget)
        self._wait_node()
        self.board = self._guest.start(
            'board', f'python {INSIDE}/relay.py /dev/ttyGS0 /dev/virtio-ports/gadget')
        self.board.wait_for('carrying')

    def unplug(self):
        if self.board is not None:          # as long as it has its port open, the module stays
            self.board.signal('KILL')
            self.board.stop()
        self._guest.run('rmmod g_serial')
        self._disconnect()


KINDS = (Uart, Ftdi, Acm)
