"""Compiling exported files with gcc, for this machine and for a Cortex-M4F, which QEMU plays; and how large they are.

For tests and benchmarks: whoever uses the exported files has a tool chain of his own.
"""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-I.", "-Isrc")
SANITISED = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover")
CORTEX_M4F = ("-Os", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffunction-sections")
ARM_GCC, ARM_SIZE, QEMU = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"

Runner = Callable[..., str]
_BOARD = Path(__file__).parent / "c" / "mps2_an386"


class Size(NamedTuple):
    """Bytes on a Cortex-M4F."""

    code: int  # with constants
    memory: int  # static


def compiled(directory: Path, main: Path, program: str, *flags: str, compiler: str = "gcc") -> Path:
    """`main` and all of the exported sources, compiled without a warning to `program` in `directory`."""
    sources = sorted(path.relative_to(directory) for path in (directory / "src").glob("*.c"))
    command = [compiler, *STRICT, *(flags or ("-O2",)), main, *sources, "-lm", "-o", program]
    _run([*map(str, command)], directory)
    return directory / program


def compiled_for_cortex_m4f(directory: Path, main: Path, program: str) -> Path:
    """The same for QEMU's mps2-an386; it reads and writes files of this machine by semihosting."""
    board = str(_BOARD / "board.c"), "-T", str(_BOARD / "board.ld"), "--specs=rdimon.specs", "-Wl,--gc-sections"
    return compiled(directory, main, program, *CORTEX_M4F, *board, compiler=ARM_GCC)


def run(program: Path, *arguments: str) -> str:
    """What `program` prints; RuntimeError for whatever it prints about errors, such as a sanitizer's report."""
    return _run([str(program), *arguments], program.parent)


def run_on_cortex_m4f(program: Path, *arguments: str, options: tuple[str, ...] = ()) -> str:
    """The same on QEMU's mps2-an386, with further `options` of QEMU."""
    names = ",".join(f"arg={argument}" for argument in (program.name, *arguments))
    command = [QEMU, "-M", "mps2-an386", "-nographic", "-kernel", program.name, *options]
    return _run([*command, "-semihosting-config", f"enable=on,target=native,{names}"], program.parent)


def sizes(directory: Path) -> dict[str, Size]:
    """Size of each of the exported sources on a Cortex-M4F, without what they take from the C library."""
    found = {}
    for source in sorted((directory / "src").glob("*.c")):
        made = source.with_suffix(".o")
        _run([ARM_GCC, *STRICT, *CORTEX_M4F, "-c", str(source), "-o", str(made)], directory)
        found[source.name] = size_of(made)
        made.unlink()
    return found


def linked_size(directory: Path) -> Size:
    """Size of a program that calls `ant_step` again and again, with all that it takes from newlib-nano."""
    smallest = "-fdata-sections", "-Wl,--gc-sections", "--specs=nano.specs", "--specs=nosys.specs", "-Wl,--no-warnings"
    return size_of(compiled(directory, _BOARD / "step.c", "step.elf", *CORTEX_M4F, *smallest, compiler=ARM_GCC))


def size_of(binary: Path) -> Size:
    """Size of an object file or of a program."""
    text, data, bss = map(int, _run([ARM_SIZE, str(binary)], binary.parent).splitlines()[1].split()[:3])
    return Size(text + data, data + bss)


def _run(command: list[str], directory: Path) -> str:
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=120)
    if done.returncode or done.stderr:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}\n{done.stderr}")
    return done.stdout


__all__ = [
    "ARM_GCC",
    "CORTEX_M4F",
    "QEMU",
    "SANITISED",
    "STRICT",
    "Size",
    "compiled",
    "compiled_for_cortex_m4f",
    "linked_size",
    "run",
    "run_on_cortex_m4f",
    "size_of",
    "sizes",
]
