"""Compilation of exported files with gcc, for this machine and for a Cortex-M4F or M7 in QEMU; and their sizes.

For tests and benchmarks only: users of the exported files have their own tool chain.
"""

import re
import subprocess
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeAlias
from zlib import crc32

WARNINGS = ("-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wfloat-equal", "-Werror")
STRICT = ("-std=c99", *WARNINGS, "-I.", "-Isrc")
QUICK = ("-O1",)  # where another test compiles similar sources at a user's -O2, in half of the time
SANITISED = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover")
ARM_GCC, ARM_SIZE, QEMU = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"


class Core(NamedTuple):
    """Processor: flags of the compiler, and the machine of QEMU that has it."""

    flags: tuple[str, ...]
    machine: str


_SMALL = "-Os", "-ffunction-sections", "-fdata-sections", "-mthumb", "-mfloat-abi=hard"
M4F = Core((*_SMALL, "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"), "mps2-an386")
M7 = Core((*_SMALL, "-mcpu=cortex-m7", "-mfpu=fpv5-d16"), "mps2-an500")  # with an FPU for double precision
CORTEX_M4F = M4F.flags

Runner = Callable[..., str]
Args: TypeAlias = tuple[str, ...]
_COMPILED: dict[Args, list[bytes]] = {}  # objects by command and preprocessed text: exports differ in few files
_BOARD, _REPLAY = (Path(__file__).parent / "c" / name for name in ("mps2_an386", "replay"))


class Size(NamedTuple):
    """Bytes on a Cortex-M."""

    code: int  # with constants
    memory: int  # static


def compiled(directory: Path, main: Path, program: str, *flags: str, compiler: str = "gcc", linked: Args = ()) -> Path:
    """Compile `main`, the files `linked` and all exported sources without a warning to `program`."""
    flags = flags or ("-O2",)
    command = [compiler, *STRICT, *flags, main, *linked, *_objects(directory, flags, compiler), "-lm", "-o", program]
    _run([*map(str, command)], directory)
    return directory / program


def compiled_for_cortex(directory: Path, main: Path, program: str, core: Core = M4F) -> Path:
    """Compile the same for QEMU's machine of `core`, which reads and writes files of this machine by semihosting."""
    board = str(_BOARD / "board.c"), "-T", str(_BOARD / "board.ld"), "--specs=rdimon.specs", "-Wl,--gc-sections"
    return compiled(directory, main, program, *core.flags, compiler=ARM_GCC, linked=board)


def _objects(directory: Path, flags: Args, compiler: str) -> list[Path]:
    """Return the exported sources compiled with these flags, each once, on two processors.

    A Cortex's objects have graphs of their calls beside them, for `stack`.
    """
    folder = directory / f"objects-{crc32(repr((compiler, flags)).encode()):08x}"
    sources = sorted((directory / "src").glob("*.c"), key=lambda source: -source.stat().st_size)
    kinds = (".o", ".ci") if compiler == ARM_GCC else (".o",)
    command = [compiler, *STRICT, *flags, *["-fcallgraph-info=su"] * (".ci" in kinds)]

    def compile_one(source: Path) -> None:
        key = (*command, source.name, _run([*command, "-E", "-P", str(source)], directory))
        made = [folder / f"{source.stem}{kind}" for kind in kinds]
        if key not in _COMPILED:
            _run([*command, "-c", str(source), "-o", str(made[0])], directory)
            _COMPILED[key] = [file.read_bytes() for file in made]
        for file, content in zip(made, _COMPILED[key], strict=True):
            file.write_bytes(content)

    if not folder.exists():
        folder.mkdir()
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(compile_one, sources))
    return [folder / f"{source.stem}.o" for source in sources]


def compiled_counting(directory: Path) -> Path:
    """Compile a program that counts the multiplications of each step's QP; see its two files."""
    _run(["g++", "-O1", "-I.", "-Isrc", "-c", str(_REPLAY / "counted.cpp"), "-o", "counted.o"], directory)
    linked = "counted.o", "-Wl,--allow-multiple-definition", "-lstdc++"  # the first definitions count
    return compiled(directory, _REPLAY / "count.c", "count", "-O2", linked=linked)


def run(program: Path, *arguments: str) -> str:
    """Return the output of `program`. Raises RuntimeError for output on errors, such as a sanitizer's report."""
    return _run([str(program), *arguments], program.parent)


def run_on_cortex(program: Path, *arguments: str, options: tuple[str, ...] = (), core: Core = M4F) -> str:
    """Return the same on QEMU's machine of `core`, with further `options` of QEMU."""
    names = ",".join(f"arg={argument}" for argument in (program.name, *arguments))
    command = [QEMU, "-M", core.machine, "-nographic", "-kernel", program.name, *options]
    return _run([*command, "-semihosting-config", f"enable=on,target=native,{names}"], program.parent)


def sizes(directory: Path) -> dict[str, Size]:
    """Return the sizes of the exported sources on a Cortex-M4F by name, without the C library."""
    return {f"{made.stem}.c": size_of(made) for made in _objects(directory, CORTEX_M4F, ARM_GCC)}


def linked_size(directory: Path, core: Core = M4F) -> Size:
    """Return the size of a program that calls `ant_step` repeatedly, including its part of newlib-nano."""
    smallest = "-Wl,--gc-sections", "--specs=nano.specs", "--specs=nosys.specs", "-Wl,--no-warnings"
    made = compiled(directory, _BOARD / "step.c", "step.elf", *core.flags, compiler=ARM_GCC, linked=smallest)
    return size_of(made)


def stack(directory: Path, *flags: str, entry: str = "ant_step") -> int:
    """Return the bytes of the stack on the deepest chain of calls from `entry`, without the C library."""
    own: dict[str, int] = {}
    calls: dict[str, set[str]] = defaultdict(set)
    for made in _objects(directory, flags, ARM_GCC):
        graph = made.with_suffix(".ci")
        text = graph.read_text()
        own |= {name: int(size) for name, size in re.findall(r'title: "([^"]*)" label: "[^"]*?(\d+) bytes', text)}
        for caller, called in re.findall(r'sourcename: "([^"]*)" targetname: "([^"]*)"', text):
            calls[caller].add(called)

    @cache
    def deepest(name: str) -> int:
        return own.get(name, 0) + max(map(deepest, calls[name]), default=0)

    return deepest(entry)


def size_of(binary: Path) -> Size:
    """Return the size of an object file or of a program."""
    text, data, bss = map(int, _run([ARM_SIZE, str(binary)], binary.parent).splitlines()[1].split()[:3])
    return Size(text + data, data + bss)


def _run(command: list[str], directory: Path) -> str:
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=120)
    if done.returncode or done.stderr:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}\n{done.stderr}")
    return done.stdout
