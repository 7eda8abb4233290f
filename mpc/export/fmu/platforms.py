"""Platforms of an FMU's binaries by their names in FMI 3.0, and the compilation of a library for each."""

import platform
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from allocator.errors import InvalidInput
from mpc.export.building import compile_c, write
from mpc.export.parts import Files

_TARGETS = {  # of Zig's C compiler
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}
PLATFORMS = tuple(_TARGETS)
_SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
_SYSTEMS = {"win32": "windows"}
_MACHINES = {"AMD64": "x86_64", "arm64": "aarch64", "ARM64": "aarch64"}


def this_machine() -> str:
    """Return the platform of this machine."""
    machine = platform.machine()
    return f"{_MACHINES.get(machine, machine)}-{_SYSTEMS.get(sys.platform, sys.platform)}"


def checked(platforms: Sequence[str] | None) -> tuple[str, ...]:
    """Return the platforms, by default that of this machine. Raises `InvalidInput` for unknown ones."""
    if platforms is None:
        return (this_machine(),)
    known = {*PLATFORMS, this_machine()}
    if isinstance(platforms, str) or not known.issuperset(platforms):
        raise InvalidInput(f"platforms = {platforms!r} has to be a sequence of {', '.join(sorted(known))}")
    return tuple(dict.fromkeys(platforms))


def binary(
    identifier: str, sources: Files, units: Sequence[str], includes: Sequence[str], on: str
) -> tuple[str, bytes]:
    """Return the name in the archive and the content of the library for the platform `on`.

    The C compiler of Linux and macOS serves this machine, the package ziglang all other platforms. Raises
    `AntagonistError`, `MissingBackend` without a compiler, and `MissingPackage` without ziglang.
    """
    system = on.rpartition("-")[2]
    if system not in _SUFFIXES:
        raise InvalidInput(f"FMUs have binaries for {', '.join(PLATFORMS)}, not for {on}: write the sources only")
    name = identifier + _SUFFIXES[system]
    own = on == this_machine() and system != "windows"  # Windows has no compiler of a usual name
    flags = ["-O2", "-fPIC", "-shared", "-s", "-fvisibility=hidden", *(f"-I{directory}" for directory in includes)]
    with tempfile.TemporaryDirectory(prefix="antagonist-fmu-") as made:
        directory = write(sources, Path(made) / "c")
        compile_c("the FMU", directory, *flags, *units, "-lm", "-o", name, target=None if own else _TARGETS[on])
        return f"binaries/{on}/{name}", (directory / name).read_bytes()
