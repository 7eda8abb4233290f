"""Machine and versions of the measurements."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("numpy", "scipy", "casadi", "daqp", "osqp", "qpsolvers", "cvxpy", "clarabel")


def processor() -> str:
    """Return the processor's name if the system reports it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def machine() -> str:
    """Return one sentence on the machine."""
    return f"{processor()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def versions() -> str:
    """Return the solvers' versions in one line."""
    return ", ".join(f"{package} {version(package)}" for package in PACKAGES)
