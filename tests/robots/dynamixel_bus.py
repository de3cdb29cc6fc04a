"""Stand-in for Dynamixel motors on a serial port: Protocol 2.0, byte by byte, on a pseudo-terminal.

Frames are FF FF FD 00, id, length (2), instruction, parameters, CRC-16 (polynomial 0x8005),
little-endian; see the Robotis e-Manual, "Protocol 2.0". The tables of registers are the X series'.
Time is what a test says it is, so that nothing hangs on the speed of the machine.
"""

import contextlib
import os
import pty
import struct
import threading
import tty

from dynamixel_sdk import PacketHandler, PortHandler

HEADER = b"\xff\xff\xfd\x00"
READ = 0x02
WRITE = 0x03
STATUS = 0x55
SYNC_READ = 0x82
SYNC_WRITE = 0x83
EVERYBODY = 0xFE
OPERATING_MODE = 11
TORQUE = 64
WATCHDOG = 98
GOALS = range(100, 104)


def crc(data):
    """CRC-16 of Protocol 2.0."""
    return PacketHandler(2.0).updateCRC(0, data, len(data))


class Ticking:
    """A clock that stands still but for a tick whenever it is read: `time` [s] is set by the
    test."""

    TICK = 1e-7  # [s]

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        self.time += self.TICK
        return self.time


class Motor:
    """A motor that is at once where it should be."""

    def __init__(self, position, clock):
        self.table = bytearray(256)
        self.heard = 0.0
        self._clock = clock
        self.table[OPERATING_MODE] = 3  # of positions, as motors are delivered
        self.table[TORQUE] = 1  # as somebody may have left it
        struct.pack_into("<H", self.table, 38, 1193)  # current limit
        struct.pack_into("<i", self.table, 132, position)

    def read(self, address, size):
        return bytes(self.table[address : address + size])

    def write(self, address, data):
        if address in GOALS and (not self.table[TORQUE] or self.has_stopped):
            return
        if address == OPERATING_MODE and self.table[TORQUE]:
            return  # registers of the EEPROM are locked under torque
        self.table[address : address + len(data)] = data
        if address == 102:
            self.table[126:128] = data  # the present current

    @property
    def has_stopped(self):
        """Whether the bus was silent for as long as the watchdog waits."""
        patience = 0.02 * self.table[WATCHDOG]
        return patience > 0.0 and self._clock() - self.heard > patience

    @property
    def goal_current(self):
        return struct.unpack_from("<h", self.table, 102)[0]


class Bus:
    """Motors by their ids, on a pseudo-terminal with the name `port`. `silent`: ids that do not
    answer any more."""

    def __init__(self, positions):
        self.clock = Ticking()
        self.motors = {
            number: Motor(position, self.clock) for number, position in positions.items()
        }
        self.silent = set()
        self.is_unplugged = False
        self.taken, self.answered = 0, 0  # bytes of commands that were carried out, and of answers
        self._master, slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave
        threading.Thread(target=self._serve, daemon=True).start()

    def unplug(self):
        """The cable is gone: the port hangs up."""
        self.is_unplugged = True
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
                    self.taken += end

    def _take(self, frame):
        assert crc(frame[:-2]) == struct.unpack("<H", frame[-2:])[0]
        number = frame[4]
        instruction = frame[7]
        body = frame[8:-2]
        for motor in self.motors.values():
            if not motor.has_stopped:
                motor.heard = self.clock()
        if number not in (*self.motors, EVERYBODY):
            return
        address = 0
        size = 0
        if len(body) >= 4:
            address, size = struct.unpack_from("<HH", body)
        if instruction == READ:
            self._answer(number, self.motors[number].read(address, size))
        elif instruction == WRITE:
            for motor in self.motors.values() if number == EVERYBODY else [self.motors[number]]:
                if struct.unpack_from("<H", body)[0] == WATCHDOG:
                    motor.heard = self.clock()
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
        frame += struct.pack("<H", crc(frame))
        self.answered += len(frame)
        os.write(self._master, frame)


class Port(PortHandler):
    """The serial port at the other end of a bus. It gives up an answer once the bus has carried out
    all that was sent and said all that it will say, and not after a time."""

    def __init__(self, name, bus):
        super().__init__(name)
        self._bus = bus
        self._sent = bus.taken
        self._heard = bus.answered

    def writePort(self, packet):
        count = super().writePort(packet)
        self._sent += count
        return count

    def readPort(self, length):
        found = super().readPort(length)
        self._heard += len(found)
        return found

    def clearPort(self):
        """Leaves out answers to earlier commands, also those that are still on their way."""
        while self._heard < self._bus.answered and not self._bus.is_unplugged:
            self.readPort(1)

    def isPacketTimeout(self):
        has_taken = self._bus.taken >= self._sent
        return self._bus.is_unplugged or (has_taken and self._heard >= self._bus.answered)
