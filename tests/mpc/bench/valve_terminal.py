"""A valve terminal that does not exist: pymodbus' own server on the loopback address, before a simulated joint."""

import asyncio
import struct
import threading

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from allocator import BAR, DEG

HOST = "127.0.0.1"


class Server(ModbusTcpServer):
    """A server that closes what it has opened, on its own side, too."""

    transports: list

    def callback_new_connection(self):
        handler = super().callback_new_connection()
        made = handler.connection_made

        def noted(transport):
            self.transports.append(transport)
            made(transport)

        handler.connection_made = noted
        return handler

    async def shutdown(self):
        await asyncio.sleep(0.05)  # in which connections that are being made are there to be closed
        await super().shutdown()
        for transport in self.transports:
            transport.abort()
        await asyncio.sleep(0.05)  # in which they close


class ValveTerminal:
    """The registers of `generic_valve_terminal.toml`, written and read by a server in a thread of its own.

    `device` is the joint behind it. What makes it a bad one: `refuse`, an exception code for every request; `silent`,
    answers that never come; `requests` counts by function code.
    """

    def __init__(self, device):
        self.device, self.refuse, self.silent, self.requests = device, False, False, {}
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)

    def __enter__(self):
        self.device.__enter__()
        self._thread.start()
        assert self._ready.wait(10)
        return self

    def __exit__(self, *error):
        self.close()
        self._thread.join(10)
        assert not self._thread.is_alive()

    def close(self):
        """End the server and all of its connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._over.set)

    async def _serve(self):
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        block = [SimData(0, count=10, values=0, datatype=DataType.REGISTERS)]
        bits = [SimData(0, count=1, values=False, datatype=DataType.BITS)]
        simulated = SimDevice(1, (bits, bits, block, block), action=self._asked)
        server = Server(simulated, address=(HOST, 0))
        server.transports = []
        await server.serve_forever(background=True)
        self.port = server.transport.sockets[0].getsockname()[1]
        self._ready.set()
        await self._over.wait()
        await server.shutdown()

    async def _asked(self, function, start, address, count, registers, values):
        self.requests[function] = self.requests.get(function, 0) + 1
        if self.silent:
            await asyncio.sleep(60)
        if self.refuse:
            return ExcCodes.DEVICE_BUSY
        if function == 4:
            _, theta, (P1, P2) = self.device.read()
            (angle,) = struct.unpack(">H", struct.pack(">h", round(theta / DEG / 0.01)))
            registers[:3] = [angle, *(min(max(round(P / BAR * 1000), 0), 65535) for P in (P1, P2))]
        elif function == 16:
            registers[address : address + count] = values
            self.device.write(*(1e-3 * BAR * number for number in registers[:2]))
        return None
