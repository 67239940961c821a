# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
DeviceRegistry: the devices of a bus, and what happens to them when an instruction is carried out.

It does not ask whether an answer belongs to an instruction: that is the tracker's. At most 253
devices; an ID is a key here and may change, a Device is the thing that answers to it.
"""

from collections.abc import Iterable

from msg_defs.dxl1_instruction import Dialect
from msg_defs.dxl1_instruction import DIALECTS
from msg_defs.dxl1_instruction import UNDECIDED
from msg_defs.dxl_instruction import ALERT
from msg_defs.dxl_instruction import ERROR
from msg_defs.dxl_instruction import MULTI_TURN
from msg_defs.dxl_instruction import RESTORE
from msg_defs.dxl_packet import BROADCAST
from msg_defs.uart import byte_ns
from servobus.bus import evidence as ev
from servobus.bus.device import Device
from servobus.bus.device import OFFSET
from servobus.bus.device import PLACE
from servobus.bus.device import RETURN_LEVEL
from servobus.bus.device import TORQUE
from servobus.bus.evidence import Evidence
from servobus.bus.expected_devices import Expected
from servobus.bus.expected_devices import MAX_ID
from servobus.bus.plan import Effect
from servobus.bus.report import IdWrite
from servobus.bus.report import NEW_ID
from servobus.bus.table import IDENTITY_REGISTERS
from servobus.bus.table import NO_SPAN
from servobus.bus.table import READ
from servobus.bus.table import Span
from servobus.bus.table import WRITTEN
from servobus.model.control_table import Model
from servobus.model.control_table import UNKNOWN
from servobus.model.layers import model_key
from servobus.model.models import Models

NO_ID = 255
OLD_ID_ANSWERS_NEEDED = 3          # under an ID that it lost: there is another one
ABSENCE_MIN_MS = 50                # missed for so long: it was away, which is worth a note
FACTORY_ID = 1
FACTORY_BAUD, FACTORY_BAUD_1 = 57_600, 1_000_000  # Protocol 2.0, the 1.0 family
CALIBRATION_CODE = 128             # as Torque Enable of Feetech: this position is the middle
_RESET_KEEPS: dict[str, tuple[str, ...]] = {
    'all': (), 'all except ID': ('ID',), 'all except ID and Baud Rate': ('ID', 'Baud Rate'),
    '': ('ID', 'Baud Rate'),
}
_CALIBRATED_REGISTERS = (PLACE, OFFSET)
_LOCK = (55, 1)                    # the use of Lock of Feetech, where registers are not known
# Where a device of unknown model has its ID, by its protocol; the Baud Rate comes after it.
_ID_AT = {'2': (7,), '1': (3,), 'feetech': (5,), '1 or feetech': (3, 5)}
_DIALECTS = {dialect.protocol: dialect for dialect in DIALECTS}
_CLEARS = {MULTI_TURN: PLACE, ERROR: 'Hardware Error Status'}


class DeviceRegistry:
    """
    The devices, by the ID they answer to. baud: the rate of this bus; byte_ns: what it means.

    plans_hold: False once a device has another ID or model: plans made before are no longer right.
    new_ids: of devices that were made since somebody cleared it.
    """

    def __init__(self, models: Models, expected: Iterable[Expected], baud: int,
                 evidence: Evidence) -> None:
        self._models = models
        self.baud, self.byte_ns = baud, byte_ns(baud)
        self.tried = {baud}                # rates, one after the other
        self._evidence = evidence
        self.devices: dict[int, Device] = {}
        self.dialect = UNDECIDED           # in the 1.0 family, for devices that speak it
        self.highest = MAX_ID              # the largest ID that a device can have here
        self._renamed: dict[int, int] = {}     # IDs that were changed: the new ones
        self._dummy = Device(NO_ID)        # takes what is sent to an ID that no device can have
        self.plans_hold = True
        self.new_ids: set[int] = set()
        self.id_writes: dict[int, IdWrite] = {}     # by the new ID
        self._followers = {'ID': self.renumber, 'Baud Rate': self._follow_baud,
                           RETURN_LEVEL: lambda device, level, _: device.set_return_level(level),
                           OFFSET: self._follow_offset, TORQUE: self._follow_torque}
        for entry in expected:
            device = self.devices[entry.id] = Device(entry.id, entry.joint, expected=True)
            model = models.by_name(entry.model) if entry.model else None
            if model is not None:
                device.dialect = _DIALECTS.get(model.protocol)
                device.model_number = model.number
                device.identity = (model.number or 0).to_bytes(2, 'little')
                device.set_model(model)

    def device(self, number: int) -> Device:
        """Return the device with this ID, new at first sight; a dummy where no device can be."""
        device = self.devices.get(number)
        if device is None:
            if number > self.highest:
                return self._dummy
            device = self.devices[number] = Device(number)
            self.new_ids.add(number)
            if number in self._renamed:
                device.moved_to = f'{NEW_ID}{self._renamed[number]:03}'
        return device

    def register_name(self, number: int, address: int) -> str:
        """Return what a device calls the register at an address; the address if not known."""
        device = self.devices.get(number)
        field = device.model.by_address.get(address) if device is not None else None
        if device is None or field is None:
            return str(address)
        return device.table.resolve_cases(field, device.model).name

    def accept_status(self, device: Device, error: int, stamp: int) -> None:
        """Take any status as a sign of life; error is its error byte, alert bit included."""
        if device.missed_in_a_row:
            silence_ms = (stamp - device.heard) // 1_000_000
            if device.heard and silence_ms >= ABSENCE_MIN_MS:
                self._evidence.add_incident(stamp, ev.RETURNED, device.number, silence_ms,
                                            self._raw(device, TORQUE, -1), device.missed_in_a_row)
            device.missed_in_a_row = 0
        alert = error >= ALERT
        if alert:
            if not device.alert:
                self._evidence.add_incident(stamp, ev.ALERT, device.number)
            device.counts.alerts += 1
        device.alert = alert
        device.heard = stamp
        device.waiting_behind = None
        if device.counts.answers >= OLD_ID_ANSWERS_NEEDED \
                or not device.moved_to.startswith(NEW_ID):
            device.moved_to = ''           # else what it said before the write was read late
        device.is_unusual = error != 0        # the next good answer clears its last error

    def accept_pong(self, device: Device, data: bytes, stamp: int, is_doubtful: bool) -> None:
        """Take an answer to a Ping to all; is_doubtful: it may be one to something else."""
        device.counts.answers += 1
        if not data:
            self.set_device_dialect(device)
        elif not is_doubtful:
            device.accept_pong(NO_SPAN, data, stamp, READ)

    def accept_defining_read(self, device: Device, span: Span, data: bytes, stamp: int,
                     source: int) -> None:
        """Keep what a device said of itself, where that may change what it is or does."""
        address = span[0]
        self._read_identity(device, address, data, stamp)
        device.table.keep(span, data, stamp, source)
        self.resolve(device)
        for name, value in device.special_values(address, data):
            if name == RETURN_LEVEL:
                device.set_return_level(value)

    def resolve(self, device: Device) -> None:
        """Give a device the model that it said it is, before anything depends on that."""
        if not device.is_unresolved:
            return
        device.is_unresolved = False
        identity = device.identity
        number = identity[0] | identity[1] << 8
        firmware = identity[2] if len(identity) > 2 else None
        if device.model_number not in (None, number):
            device.forget_answering()
            device.registered = None
        device.model_number = number
        device.firmware = firmware
        device.set_model(
            self._models.get(model_key(number, device.protocol), firmware) or UNKNOWN)
        self.plans_hold = False
        if (at := device.identity_at) >= 0:
            device.table.store(at, identity[:2], device.identity_stamp, READ)
        field = device.model.by_name.get('Firmware Version')
        if firmware is not None and field is not None and field.size == 1:
            device.table.store(field.at, identity[2:], device.identity_stamp, READ)

    def assume_model(self, device: Device, model: Model) -> None:
        """Give a device of an unknown model the registers that what is used of it speaks for."""
        if device.model_number is None and device.model is not model:
            if model is UNKNOWN:
                device.forget_answering()
            device.set_model(model)           # plans hold: what they counted is worth more

    def _read_identity(self, device: Device, address: int, data: bytes, stamp: int) -> None:
        at = device.identity_at - address
        number = data[at:at + 2]
        if not 0 <= at <= len(data) - 2 or number == device.identity[:2]:
            return
        model = self._models.get(
            model_key(number[0] | number[1] << 8, device.protocol)) or UNKNOWN
        field = model.by_name.get('Firmware Version')
        firmware = b''
        if field is not None and field.size == 1 and field.at >= address:
            firmware = data[field.at - address:field.end - address]
        device.identify(number + firmware, stamp)

    def is_impossible_id(self, number: int) -> bool:
        """Tell whether no device can have this ID, and it is not everybody's either."""
        return number > self.highest and number != BROADCAST

    def set_dialect(self, dialect: Dialect) -> None:
        """Say which dialect of the 1.0 family is spoken here; devices are then known by it."""
        self.dialect = dialect
        for device in self.devices.values():
            if device.dialect is not None:
                self.set_device_dialect(device)
        self.plans_hold = False

    def set_device_dialect(self, device: Device) -> None:
        """Say that a device speaks the dialect of this bus, and look who it is."""
        device.dialect = self.dialect
        at = self.dialect.identity_at
        number = device.table.bytes(at, 2) if at >= 0 else None
        if number is None or number == device.identity[:2]:
            return
        self._read_identity(device, at, number, device.heard)
        self.resolve(device)
        if device.firmware is None:
            device.firmware = device.seen_code('Firmware Version')

    def store_error_bits(self, number: int, at: int, error: int, stamp: int) -> None:
        """Keep the error byte of a status of the 1.0 family where its table has it."""
        if number <= self.highest:
            device = self.device(number)
            device.error_bits = error
            device.table.store(at, bytes([error]), stamp, READ)

    def calibrate(self, device: Device, stamp: int) -> None:
        """Forget what a Calibrate of Feetech changes."""
        self._evidence.add_incident(stamp, ev.CALIBRATED, device.number)
        self.resolve(device)
        device.table.forget('all', device.model,
                            device.model.by_name.keys() - _CALIBRATED_REGISTERS)

    def write(self, device: Device, address: int, data: bytes, stamp: int,
              alone: bool = True) -> None:
        """
        Keep what the master wrote, and follow what it changes about the device.

        alone: False for a write to everybody where there are several: an ID that all of them
        take at once is the same for all, so each stays who it was.
        """
        device.counts.writes += 1
        if device.is_unresolved:
            self.resolve(device)           # its model says how much of the table is kept
        if address < device.followed_end and device.is_changed_by(address, len(data)):
            self.follow_write(device, address, data, stamp, alone)
        device.table.keep((address, len(data)), data, stamp, WRITTEN)

    def is_new_id(self, effect: Effect, number: int) -> bool:
        """
        Return whether a write gives a device this ID: some acknowledge it with the new one.

        Where its registers are not known: the byte written there, a number never heard.
        """
        action, (device, *written, _) = effect
        if action != self.write:
            return False
        self.resolve(device)
        other = self.devices.get(number)
        return ('ID', number) in device.special_values(*written) or (
            written[1] == bytes((number,)) and written[0] in _ID_AT[device.protocol]
            and 'ID' not in device.model.by_name
            and (other is None or not other.heard))

    def register_write(self, device: Device, address: int, data: bytes, stamp: int,
                 alone: bool = True) -> None:
        """Keep a Reg Write until its Action."""
        is_again = device.registered is not None and device.registered[0] == address
        device.replaced = device.replaced + 1 if is_again else 0
        if is_again:
            self._evidence.add_incident(stamp, ev.REPLACED, device.number, device.replaced)
        device.registered = address, data, alone

    def write_registered(self, device: Device, stamp: int) -> None:
        """Carry out the registered write, at an Action."""
        self.resolve(device)                   # another one never heard it
        if device.registered is not None:
            address, data, alone = device.registered
            self.write(device, address, data, stamp, alone)
            device.registered = None

    def reboot(self, device: Device, stamp: int) -> None:
        """Forget what a device loses when it restarts."""
        self._evidence.add_incident(stamp, ev.REBOOTED, device.number)
        self.resolve(device)
        device.table.forget('ram', device.model)
        device.registered = None

    def factory_reset(self, device: Device, option: str, stamp: int) -> None:
        """Forget what a Factory Reset changes; with 'all' the ID becomes 1."""
        self.reboot(device, stamp)
        kept = _RESET_KEEPS[option]
        device.table.forget('all', device.model, (*IDENTITY_REGISTERS, *kept))
        if 'Baud Rate' not in kept:
            baud = FACTORY_BAUD if device.dialect is None else FACTORY_BAUD_1
            self._set_moved(device, baud, f'{baud} Bd')
        if 'ID' not in kept:
            self.renumber(device, FACTORY_ID, stamp)

    def clear(self, device: Device, option: str, stamp: int) -> None:
        """Forget the one register that a Clear changes."""
        gone = _CLEARS.get(option)
        self.resolve(device)
        device.table.forget('all', device.model, device.model.by_name.keys() - {gone})

    def restore(self, device: Device, option: str, stamp: int) -> None:
        """Forget everything when a Control Table Backup is restored, nothing if it is stored."""
        if option == RESTORE:
            self.reboot(device, stamp)
            device.table.forget('all', device.model, (*IDENTITY_REGISTERS, 'ID', 'Baud Rate'))

    def follow_write(self, device: Device, address: int, data: bytes, stamp: int,
               alone: bool = True) -> None:
        """
        Note what a write to EEPROM or to Status Return Level changes about the device.

        Its table still has what was there before: only what needs that looks it up.
        """
        self.resolve(device)
        field = device.model.by_address.get(address)
        is_kept = field is not None and field.memory == 'eeprom'
        device.counts.eeprom_writes += is_kept
        if field is None and address in _ID_AT[device.protocol]:
            self._note_new_id(device, data, stamp)
        is_locked = is_kept and 'Lock' in device.model.by_name and device.seen_code('Lock') == 1
        for name, value in device.special_values(address, data):
            if name == 'ID' and value != device.number:
                self._note_new_id(device, data[device.model.by_name['ID'].at - address:], stamp)
            if alone or name != 'ID':
                self._followers[name](device, value, stamp)
        if is_locked:
            self._evidence.add_incident(stamp, ev.LOCKED, device.number, address)

    def _note_new_id(self, device: Device, data: bytes, stamp: int) -> None:
        """Keep that a device got another ID, the first of these bytes."""
        number, stamp = data[0], max(stamp, device.heard)      # that of its acknowledgement
        if not device.heard or not device.number != number <= self.highest:
            return
        self.id_writes.pop(device.number, None)
        before = self.id_writes.get(number)
        ids = before.ids if before is not None and before.stamp == stamp else ()
        baud = data[1] if len(data) > 1 else -1
        is_locked = _LOCK not in device.used and self._raw(device, 'Lock', 1) != 0
        self.id_writes[number] = IdWrite(number, (*ids, device.number), stamp, baud, is_locked)

    def report_id_writes(self) -> tuple[IdWrite, ...]:
        """Return the last write of each new ID; an old ID may have answered since."""
        for one in self.id_writes.values():
            heard = [device.heard for number in one.ids if (device := self.devices.get(number))]
            if not one.back and max(heard, default=0) > one.stamp:
                self.id_writes[one.number] = one._replace(back=max(heard))
        return tuple(self.id_writes.values())

    def _follow_baud(self, device: Device, value: int, stamp: int) -> None:
        self._evidence.add_incident(stamp, ev.BAUD_WRITTEN, device.number, value)
        field = device.model.by_name['Baud Rate']
        baud = int(field.decode(field.bytes_of(value)).number or 0)
        self._set_moved(device, baud,
                        f'{baud} Bd' if baud else f'an unknown baud rate (code {value})')

    def _follow_offset(self, device: Device, value: int, stamp: int) -> None:
        before = self._raw(device, OFFSET)
        if value != before:
            self._evidence.add_incident(stamp, ev.OFFSET_WRITTEN, device.number, value, before,
                                        self._raw(device, PLACE))

    def _follow_torque(self, device: Device, value: int, stamp: int) -> None:
        if value == CALIBRATION_CODE:
            self.calibrate(device, stamp)

    def set_baud(self, baud: int) -> None:
        """Follow the master to another rate, as devices do whose rate it has changed."""
        self.baud, self.byte_ns = baud, byte_ns(baud)
        self.tried.add(baud)
        for device in self.devices.values():
            if not device.heard:               # it may not have been meant at all
                device.missed_in_a_row = 0
            if device.moved_to == f'{baud} Bd':
                device.moved_to = ''

    def _set_moved(self, device: Device, baud: int, in_words: str) -> None:
        if baud != self.baud:
            device.moved_to = in_words
            device.is_unusual = True

    def renumber(self, device: Device, number: int, stamp: int) -> None:
        """Give a device another ID, if that is free."""
        if number > self.highest or self.devices.get(device.number) is not device:
            return
        other = self.devices.get(number)
        if other is device or (
                other is not None and other.heard and not other.missed_in_a_row):
            return             # itself, or one that is there and answers
        if other is not None and other.expected:
            device.joint, device.expected = other.joint, True
        del self.devices[device.number]
        self._renamed[device.number] = number
        device.number = number
        self.devices[number] = device
        self.plans_hold = False

    def _raw(self, device: Device, name: str, unknown: int = 0) -> int:
        """Return what is known of a register."""
        self.resolve(device)
        code = device.seen_code(name)
        return unknown if code is None else code
