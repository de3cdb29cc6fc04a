"""Stand-in for Dynamixel motors on a serial port: Protocol 2.0, byte by byte, on a pseudo-terminal.

Frames are FF FF FD 00, id, length (2), instruction, parameters, CRC-16 (polynomial 0x8005),
little-endian; see the Robotis e-Manual, "Protocol 2.0". The tables of registers are the X series'.
"""

import contextlib
import os
import pty
import struct
import threading
import time
import tty

from dynamixel_sdk import PacketHandler

HEADER = b"\xff\xff\xfd\x00"
READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE, EVERYBODY = 0x02, 0x03, 0x55, 0x82, 0x83, 0xFE
TORQUE, WATCHDOG, GOALS = 64, 98, range(100, 104)


def crc(data):
    """CRC-16 of Protocol 2.0."""
    return PacketHandler(2.0).updateCRC(0, data, len(data))


class Motor:
    """A motor that is at once where it should be."""

    def __init__(self, position):
        self.table, self.heard = bytearray(256), 0.0
        struct.pack_into("<H", self.table, 38, 1193)  # current limit
        struct.pack_into("<i", self.table, 132, position)

    def read(self, address, size):
        return bytes(self.table[address : address + size])

    def write(self, address, data):
        if address in GOALS and (not self.table[TORQUE] or self.has_stopped):
            return
        self.table[address : address + len(data)] = data
        if address == 102:
            self.table[126:128] = data  # the present current

    @property
    def has_stopped(self):
        """Whether the bus was silent for as long as the watchdog waits."""
        return (
            0.02 * self.table[WATCHDOG] < time.perf_counter() - self.heard
            if self.table[WATCHDOG]
            else False
        )

    @property
    def goal_current(self):
        return struct.unpack_from("<h", self.table, 102)[0]


class Bus:
    """Motors by their ids, on a pseudo-terminal with the name `port`. `silent`: ids that do not
    answer any more."""

    def __init__(self, positions):
        self.motors = {number: Motor(position) for number, position in positions.items()}
        self.silent = set()
        self._master, slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        threading.Thread(target=self._serve, daemon=True).start()

    def unplug(self):
        """The cable is gone: the port hangs up."""
        for end in (self._slave, self._master):
            os.close(end)

    def _serve(self):
        buffer = b""
        with contextlib.suppress(OSError):  # where the port has hung up
            while True:
                buffer += os.read(self._master, 1024)
                while (start := buffer.find(HEADER)) >= 0 and len(buffer) >= start + 7:
                    end = start + 7 + struct.unpack_from("<H", buffer, start + 5)[0]
                    if len(buffer) < end:
                        break
                    self._take(buffer[start:end])
                    buffer = buffer[end:]

    def _take(self, frame):
        assert crc(frame[:-2]) == struct.unpack("<H", frame[-2:])[0]
        number, instruction, body = frame[4], frame[7], frame[8:-2]
        for motor in self.motors.values():
            motor.heard = time.perf_counter() if not motor.has_stopped else motor.heard
        if number not in (*self.motors, EVERYBODY):
            return
        address, size = struct.unpack_from("<HH", body) if len(body) >= 4 else (0, 0)
        if instruction == READ:
            self._answer(number, self.motors[number].read(address, size))
        elif instruction == WRITE:
            for motor in self.motors.values() if number == EVERYBODY else [self.motors[number]]:
                if struct.unpack_from("<H", body)[0] == WATCHDOG:
                    motor.heard = time.perf_counter()
                motor.write(struct.unpack_from("<H", body)[0], body[2:])
            self._answer(number, b"")
        elif instruction == SYNC_READ:
            for each in body[4:]:
                self._answer(each, self.motors[each].read(address, size))
        elif instruction == SYNC_WRITE:
            for place in range(4, len(body), 1 + size):
                self.motors[body[place]].write(address, body[place + 1 : place + 1 + size])

    def _answer(self, number, data):
        if number == EVERYBODY or number in self.silent or number not in self.motors:
            return
        frame = (
            HEADER + bytes([number]) + struct.pack("<H", len(data) + 4) + bytes([STATUS, 0]) + data
        )
        os.write(self._master, frame + struct.pack("<H", crc(frame)))
