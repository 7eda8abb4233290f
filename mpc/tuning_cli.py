"""Command `antagonist tune`: the numbers of a control loop for one fitted plant or arm."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import parent_process
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

import typer

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.lazy import Console
from allocator.shell.options import grouped
from allocator.shell.outputs import AsJSON, Force, claim_result, print_json, say, write
from mpc.plant_cli import LoopOptions, PlantOptions

if TYPE_CHECKING:
    from mpc.model.compensation import Compensation
    from mpc.tuning.cost import Evaluation
    from mpc.tuning.draws import Spreads
    from mpc.tuning.result import Tuned

_KEPT = ".before-tuning"  # suffix of a copy's name


@grouped
def tune_command(
    options: PlantOptions,
    at: LoopOptions,
    out: Annotated[
        Path | None,
        typer.Option(
            help="TOML file to write the plant with its table [tuning] to, for --machine; of a MuJoCo model the table "
            "alone, for --tuning"
        ),
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help=f"write [tuning] into the machine's file itself; a copy FILE{_KEPT} is kept"),
    ] = False,
    controller: Annotated[str, typer.Option(help="mpc, lqr, predictive-pid, pid or pi; mpc for an arm")] = "mpc",
    evaluations: Annotated[int, typer.Option(help="number of tunings to try")] = 60,
    draws: Annotated[int, typer.Option(help="number of real plants that each tuning is tried on")] = 8,
    peak: Annotated[
        float, typer.Option(help="limit of the sensitivity peak M_s on the model; half as much again on draws")
    ] = 2.0,
    seed: Annotated[int, typer.Option(help="seed of draws, noise and search")] = 0,
    judge: Annotated[
        int | None, typer.Option(help="seed of further draws to report both tunings on, for figures of unseen plants")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="number of processes on this machine; by default one per core")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler to run on instead, e.g. tcp://10.0.0.5:8786")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="picture of the error against M_s")] = None,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Tune a controller and its observer for a fitted plant or arm, in closed loops with machines drawn about it.

    --machine is a TOML file from fit-motion, fit-joint or init, arm26 or arm48, or a MuJoCo model (.xml), whose muscles
    the options describe.

    Plants are drawn within the 95 % intervals of the file (table [intervals] of fit-motion), or within the usual errors
    of data sheets. The search minimises the mean closed-loop cost over a sine, movements and steps, without and with a
    payload, and keeps M_s within its limits. The defaults stay unless a tuning is better by 10 %. `track`, `run` and
    `export` read the result from the file.
    """
    from rich.console import Console

    from allocator.presentation.plotting import save_figure
    from allocator.presentation.progress import counted
    from mpc.model.arm.model import Arm
    from mpc.tuning.picture import plot_tuned
    from mpc.tuning.search import tune

    target = _Target.of(options, out, in_place)
    claim_result(out, plot, target.copy, inputs=options.files, force=force)
    console = Console(stderr=as_json)
    model, known, spreads = _read(options)
    if at.stiffness is not None and isinstance(model, Arm):
        raise InvalidInput("--stiffness is for one joint; an arm is tuned with its usual stiffness")
    say(console, f"plant: {model.summary}" + f"; {known.summary}" * bool(known.summary))
    with _executor(workers, scheduler) as executor:
        tuned = tune(
            model, known, controller=controller, spreads=spreads, K=at.stiffness, peak=peak, evaluations=evaluations,
            n_draws=draws, seed=seed, dt=at.dt, horizon=at.horizon, executor=executor,
            progress=partial(counted, title="tuning"),
        )  # fmt: skip
    judged = None if judge is None else tuned.judged(judge)
    if as_json:
        print_json(tuned.to_dict(judged))
    else:
        _describe(tuned, judged, console)
    say(console, target.write(tuned, model, options))
    write(plot, lambda path: save_figure(plot_tuned(tuned), path, dpi=120), console)


class _Target(NamedTuple):
    """File that gets the tuning, if any, and the copy of the machine's file that is kept if it is the same file."""

    path: Path | None
    copy: Path | None = None

    @classmethod
    def of(cls, options: PlantOptions, out: Path | None, in_place: bool) -> Self:
        """Return the file of --out or --in-place. Raises `InvalidInput`."""
        if not in_place:
            return cls(out)
        if out is not None:
            raise InvalidInput("--in-place and --out: give one of the two")
        if options.file is None:
            raise InvalidInput(f"--in-place is for a TOML file, and --machine is {options.machine}; give --out FILE")
        return cls(Path(options.file), Path(options.file + _KEPT))

    def write(self, tuned: "Tuned", model: Any, options: PlantOptions) -> str:
        """Write the machine with its tuning, or of a MuJoCo model the tuning alone; return a sentence about it."""
        from mpc.model.arm.storage import save_arm

        if self.path is None:
            return "not written: give --out FILE, or --in-place"
        if self.copy is not None:
            self.copy.write_bytes(self.path.read_bytes())
        if options.is_mujoco:
            write_text(self.path, "\n".join(tuned.tuning.lines()).lstrip("\n") + "\n")
        else:
            if options.file is None:
                save_arm(model, self.path)
            tuned.save(options.file or self.path, self.path)
        return f"written: {self.path}" + (f", with a copy of the file before in {self.copy}" if self.copy else "")


def _read(options: PlantOptions) -> "tuple[Any, Compensation, Spreads]":
    """Return a plant or an arm, its known effects and its spreads. Raises `InvalidFile` and `InvalidInput`."""
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant

    if options.machine is None:
        raise InvalidInput("give the machine to tune for: --machine FILE, arm26 or arm48")
    if options.file and options != PlantOptions(machine=options.machine):
        raise InvalidInput(
            f"a machine's file is tuned for as it is; edit {options.file} in place of options of the machine"
        )
    if options.of_several:
        return options.arm(), options.compensation_of_arm(), options.spreads()
    return Plant.load(str(options.file)), Compensation.load(str(options.file)), options.spreads()


def _describe(tuned: "Tuned", judged: "tuple[Evaluation, Evaluation] | None", console: "Console") -> None:
    """Print the figures before and after, on the draws of the search and on others."""
    from rich.markup import escape
    from rich.table import Table

    for words, pair in (("the draws", None), ("draws of the other seed", judged))[: 1 if judged is None else 2]:
        table = Table("", "before", "after", title=f"{tuned.tuning.controller}: means over {words}")
        for row in tuned.rows(pair):
            table.add_row(*map(escape, row))
        console.print(table)
    say(console, "" if tuned.stays else tuned.tuning.summary, tuned.note, tuned.warning and f"beware: {tuned.warning}")


@contextmanager
def _executor(workers: int | None, scheduler: str | None) -> Iterator[Executor | None]:
    """Give an executor for the evaluations: processes on this machine, or a Dask cluster. Raises `MissingPackage`."""
    if scheduler is not None:
        if workers is not None:
            raise InvalidInput("--workers is for this machine, and --scheduler has its own; give one of the two")
        from distributed import Client

        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise InvalidInput(f"--scheduler {scheduler}: {error}") from None
        with client:
            yield client.get_executor()
        return
    count = os.cpu_count() or 1 if workers is None else checks.count("--workers", workers, least=1)
    if count == 1:
        yield None
        return
    with ProcessPoolExecutor(count, initializer=_follow) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _follow() -> None:
    """Ignore interrupts, which the parent process handles, and end with that process, even if it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
