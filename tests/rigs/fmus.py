"""FMUs stepped by FMPy, variable by variable."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave


def names(n: int, m: int) -> tuple[list[str], list[str], list[str]]:
    """Return the names of the states, the commands and the torques of a plant's FMU."""
    joints, muscles = [""] if n == 1 else [str(i + 1) for i in range(n)], [str(j + 1) for j in range(m)]
    states = [f"{kind}{i}" for kind in ("theta", "omega") for i in joints] + [f"P{j}" for j in muscles]
    return states, [f"u{j}" for j in muscles], [f"d{i}" for i in joints]


class Stepped:
    """Running FMU at `path`, in steps of `dt` [s]; `start` are initial values."""

    def __init__(self, path: Path, directory: Path, dt: float, start: Mapping[str, Any] | None = None) -> None:
        described = fmpy.read_model_description(str(path))
        self.dt, self.t, self.complaints = dt, 0.0, []
        self._variables = {variable.name: variable for variable in described.modelVariables}
        self.fmu = FMU3Slave(
            guid=described.guid,
            unzipDirectory=fmpy.extract(str(path), str(directory)),
            modelIdentifier=described.coSimulation.modelIdentifier,
            instanceName="it",
        )
        self._start = {} if start is None else start

    def __enter__(self) -> Self:
        self.fmu.instantiate(logMessage=lambda _environment, _status, _category, said: self.complaints.append(said))
        self.set(**self._start)
        self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()

    def reference(self, name: str) -> int:
        return int(self._variables[name].valueReference)

    def set(self, **values: Any) -> None:
        for name, value in values.items():
            self.fmu.setFloat64([self.reference(name)], np.atleast_1d(value).tolist())

    def get(self, *names: str) -> list[float]:
        return [
            (self.fmu.getInt32 if self._variables[name].type == "Int32" else self.fmu.getFloat64)(
                [self.reference(name)]
            )[0]
            for name in names
        ]

    def step(self, steps: int = 1) -> None:
        self.fmu.doStep(self.t, steps * self.dt)
        self.t += steps * self.dt
