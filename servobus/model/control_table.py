# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
What a register means: Field (bytes -> words and SI numbers) and Model (the fields of a device).

Pure values, made by field_entries.py from YAML; no bytes are kept here (bus/table.py does that).
A reader sees a number bare and short: at most six significant digits, no exponent, and no
more decimals than the register resolves. Enumerations and flags are shown in words.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import KW_ONLY
from dataclasses import replace
from decimal import Decimal
import math
import struct
from typing import Any
from typing import Literal
from typing import NamedTuple

_CODES = {'u8': 'B', 'i8': 'b', 'u16': 'H', 'i16': 'h', 'u32': 'I', 'i32': 'i', 'u64': 'Q',
          'i64': 'q', 'f32': 'f', 'f64': 'd'}
STRUCTS = {name: struct.Struct('<' + code) for name, code in _CODES.items()}
_BIG_STRUCTS = {name: struct.Struct('>' + code) for name, code in _CODES.items()}
TYPES = tuple(STRUCTS)
BYTE_ORDERS: tuple[Literal['little', 'big'], ...] = ('little', 'big')
PROTOCOLS = ('2', '1', 'feetech')
ACCESS = ('r', 'w', 'rw')
MEMORY = ('eeprom', 'ram')
Word = str | int | float


class Value(NamedTuple):
    """
    One decoded register: what a person reads, the number in the field's unit, the raw number.

    number is None where there is none to compute with: words, flags, an unknown code, NaN.
    """

    text: str
    number: float | None
    raw: int | float


class Bits(NamedTuple):
    """Part of a flags register: (raw >> shift) & mask picks the word; '' says nothing."""

    shift: int
    mask: int
    words: tuple[str, ...]


class Span(NamedTuple):
    """An enum entry for a range of codes, both ends included."""

    first: int
    last: int
    word: Word


def number_text(number: float, decimals: int | None = None) -> str:
    """At most six significant digits, no exponent, no trailing zeros, no minus zero."""
    if isinstance(number, int):
        return str(number)
    if decimals is not None:
        number = round(number, decimals)
    text = f'{number + 0.0:.6g}'
    return format(Decimal(text), 'f') if 'e' in text else text


class Cases(NamedTuple):
    """A register with a meaning that depends on another: (that one & mask) picks from `fields`."""

    by: str
    mask: int
    fields: dict[int, Field]


@dataclass(slots=True, eq=False, repr=False)
class Field:
    """
    One register: where it is, what its bytes mean. Immutable by convention.

    shown number = raw * scale + offset, in `unit` (SI). With a scale, enum and spans only name
    the codes that are not numbers, as 0 = off. `sign_bit` is for registers which count
    magnitude and direction apart (XL-320): with that bit set the bits below it count negative.
    byte_order: which byte comes first.
    key: the name a report shows, with the unit, as `Present Position (rad)`. in_words: whether the
    text of a value is words for a code, so that the raw number is shown too.
    """

    at: int
    name: str
    type: str
    _: KW_ONLY
    access: str = ''
    memory: str = ''
    unit: str = ''
    scale: float | None = None
    offset: float = 0.0
    sign_bit: int | None = None
    enum: Mapping[int, Word] | None = None
    spans: tuple[Span, ...] = ()
    flags: tuple[Bits, ...] = ()
    cases: Cases | None = None
    hexadecimal: bool = False
    byte_order: Literal['little', 'big'] = 'little'
    size: int = field(init=False)
    end: int = field(init=False)
    key: str = field(init=False)
    in_words: bool = field(init=False)
    _unpack: Callable[[bytes], tuple[Any, ...]] = field(init=False)
    _decimals: int | None = field(init=False)

    def __post_init__(self) -> None:
        self.size = STRUCTS[self.type].size
        self.end = self.at + self.size
        self.key = f'{self.name} ({self.unit})' if self.unit else self.name
        self.in_words = bool(self.enum or self.spans or self.flags)
        bits = self.flags or self.hexadecimal          # these have no sign
        self._unpack = (STRUCTS if self.byte_order == 'little' else _BIG_STRUCTS)[
            self.type.replace('i', 'u') if bits else self.type].unpack
        self._decimals = None if self.scale is None or self.type[0] == 'f' \
            else max(0, math.ceil(-math.log10(abs(self.scale))) + 2)

    def __repr__(self) -> str:
        return f'Field({self.at}, {self.name!r}, {self.type!r})'

    def moved(self, by: int, rename: Callable[[str], str]) -> Field:
        """Make the same kind of register, `by` bytes further on, under another name."""
        cases = self.cases and Cases(rename(self.cases.by), self.cases.mask, {
            code: field.moved(by, rename) for code, field in self.cases.fields.items()})
        return replace(self, at=self.at + by, name=rename(self.name), cases=cases)

    def code_of(self, raw: bytes) -> int:
        """Return the bytes of the control table as a number without a sign."""
        return int.from_bytes(raw, self.byte_order)

    def bytes_of(self, code: int) -> bytes:
        """Return the bytes of a number without a sign in the control table."""
        return code.to_bytes(self.size, self.byte_order)

    def decode(self, raw: bytes) -> Value:
        """Return the value of exactly `size` bytes as they stand in the control table."""
        code: int | float = self._unpack(raw)[0]
        if isinstance(code, float) or not self.in_words:
            return self._number(code)
        return _flags_value(code, self.flags) if self.flags else self._enum_value(code)

    def _number(self, code: float) -> Value:
        if self.hexadecimal:
            return Value(f'0x{int(code):0{2 * self.size}X}', code, code)
        number = code if self.sign_bit is None else _signed(int(code), self.sign_bit)
        if self.scale is not None:
            number = number * self.scale + self.offset
        if isinstance(number, float) and not math.isfinite(number):
            return Value(str(number), None, code)
        return Value(number_text(number, self._decimals), number, code)

    def _enum_value(self, code: int) -> Value:
        word = (self.enum or {}).get(code)
        if word is None:
            word = next((word for first, last, word in self.spans if first <= code <= last), None)
        if word is None:
            return Value(f'unknown ({code})', None, code) if self.scale is None \
                else self._number(code)
        return Value(word, None, code) if isinstance(word, str) \
            else Value(number_text(word), word, code)


def _signed(code: int, sign_bit: int) -> int:
    magnitude = code & ((1 << sign_bit) - 1)
    return -magnitude if code >> sign_bit & 1 else magnitude


def _flags_value(code: int, flags: tuple[Bits, ...]) -> Value:
    words = []
    rest = code
    for shift, mask, names in flags:
        part = code >> shift & mask
        rest &= ~(mask << shift)
        word = names[part] if part < len(names) else f'bits {shift}+ = {part}'
        if word:
            words.append(word)
    words += [f'bit {bit}' for bit in range(rest.bit_length()) if rest >> bit & 1]
    return Value(', '.join(words) or 'none', None, code)


class Indirect(NamedTuple):
    """`size` u16 addresses from `address` on say which registers the bytes from `data` on are."""

    address: int
    data: int
    size: int


@dataclass(slots=True, eq=False, repr=False)
class Model:
    """
    The control table of one device (for one firmware). Immutable by convention.

    `fields` are sorted by address and do not overlap; `by_name` knows the aliases too.
    `indirect_from`: in front of it there are no indirect data.
    `protocol`: which one the device speaks, one of PROTOCOLS.
    `torque_constant` is in N m/A at the output, None where the maker states none.
    """

    number: int | None
    name: str
    fields: tuple[Field, ...] = ()
    _: KW_ONLY
    indirect: tuple[Indirect, ...] = ()
    aliases: Mapping[str, str] = field(default_factory=dict)
    torque_constant: float | None = None
    file: str = ''
    protocol: str = '2'
    indirect_from: int = field(init=False)
    by_address: dict[int, Field] = field(init=False)
    by_name: dict[str, Field] = field(init=False)

    def __post_init__(self) -> None:
        self.fields = tuple(sorted(self.fields, key=lambda field: field.at))
        self.indirect_from = min((one.data for one in self.indirect), default=1 << 16)
        self.by_address = {field.at: field for field in self.fields}
        self.by_name = {field.name: field for field in self.fields}
        self.by_name.update((alias, self.by_name[name]) for alias, name in self.aliases.items())

    @property
    def known_name(self) -> str:
        """The name, '' of UNKNOWN."""
        return '' if self is UNKNOWN else self.name

    def __repr__(self) -> str:
        return f'Model({self.number}, {self.name!r}, {len(self.fields)} fields)'



UNKNOWN = Model(None, 'unknown')
