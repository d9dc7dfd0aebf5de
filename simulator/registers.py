"""A servo's control table as bytes: registers by name, spans of bytes by address, indirect addresses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.control_table import TABLE_SIZE, Area, Register, StatusError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class Registers:
    """The memory behind one control table, at its defaults.

    Parameters
    ----------
    table : mapping of str to Register
        The registers of the servo's model.
    """

    def __init__(self, table: Mapping[str, Register]) -> None:
        self._table = dict(table)
        self._owner: list[Register | None] = [None] * TABLE_SIZE
        for register in table.values():
            self._owner[register.address : register.end] = [register] * register.size
        self._memory = bytearray(TABLE_SIZE)
        for area in Area:
            self.reset(area)

    def get(self, name: str) -> int:
        """Value of a register."""
        register = self._table[name]
        return register.decode(bytes(self._memory[register.address : register.end]))

    @property
    def names(self) -> frozenset[str]:
        """Names of all registers."""
        return frozenset(self._table)

    def of(self, area: Area) -> frozenset[str]:
        """Names of the registers of an area."""
        return frozenset(name for name, register in self._table.items() if register.area is area)

    def default(self, name: str) -> int:
        """Value of a register when it is new, or after power-up."""
        return self._table[name].default

    def set(self, name: str, value: int) -> None:
        """Store a value, whatever the register's access and range."""
        register = self._table[name]
        self._memory[register.address : register.end] = register.encode(value)

    def reset(self, area: Area) -> None:
        """Bring all registers of an area to their defaults."""
        for name in self.of(area):
            self.set(name, self.default(name))

    def places(self, address: int, length: int) -> tuple[StatusError, list[int]]:
        """Addresses that a span of bytes stands for, indirect data bytes resolved.

        Returns
        -------
        error : StatusError
            DATA_LENGTH for nothing; ACCESS beyond the table or where there is no register at all.
        places : list of int
            Empty with an error.
        """
        if length == 0:
            return StatusError.DATA_LENGTH, []
        if address + length > TABLE_SIZE or not any(self._owner[address : address + length]):
            return StatusError.ACCESS, []
        return StatusError.NONE, [self._resolve(place) for place in range(address, address + length)]

    def read(self, places: Sequence[int]) -> bytes:
        """Bytes at the given addresses; gaps between registers hold 0."""
        return bytes(self._memory[place] for place in places)

    def split(self, address: int, data: bytes) -> tuple[StatusError, list[tuple[Register, int]]]:
        """Take a write apart into whole registers and their values.

        Returns
        -------
        error : StatusError
            ACCESS where no register begins, DATA_LENGTH where one is covered in part or there are no data.
        values : list of (Register, int)
            In order of address; empty with an error.
        """
        error, places = self.places(address, len(data))
        values: list[tuple[Register, int]] = []
        done = 0
        while done < len(places):
            register = self._owner[places[done]]
            if register is None or register.address != places[done]:
                return StatusError.ACCESS, []
            if places[done : done + register.size] != list(range(register.address, register.end)):
                return StatusError.DATA_LENGTH, []
            values.append((register, register.decode(data[done : done + register.size])))
            done += register.size
        return error, values

    def _resolve(self, address: int) -> int:
        register = self._owner[address]
        if register is None or not register.name.startswith("indirect_data_"):
            return address
        return self.get(register.name.replace("data", "address"))
