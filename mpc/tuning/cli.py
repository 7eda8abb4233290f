"""Command `antagonist tune`: the numbers of a control loop for one fitted plant."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator import checks
from allocator.errors import InvalidInput
from allocator.shell.outputs import IMAGES, Force, check_ending, claim
from allocator.shell.printing import AsJSON, print_json, say

if TYPE_CHECKING:
    from rich.console import Console

    from mpc.tuning.result import Tuned

_KEPT = ".before-tuning"  # suffix of a copy's name


def tune_command(
    plant: Annotated[Path, typer.Argument(help="TOML file of the plant, from fit-motion, fit-joint or init")],
    out: Annotated[
        Path | None, typer.Option(help="TOML file to write the plant with its table [tuning] to, for --machine")
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help=f"write [tuning] into PLANT itself; a copy PLANT{_KEPT} is kept"),
    ] = False,
    controller: Annotated[str, typer.Option(help="mpc, lqr, predictive-pid, pid or pi")] = "mpc",
    evaluations: Annotated[int, typer.Option(help="number of tunings to try")] = 60,
    draws: Annotated[int, typer.Option(help="number of real plants that each tuning is tried on")] = 8,
    peak: Annotated[float, typer.Option(help="limit of M_s, the peak of the sensitivity")] = 2.0,
    seed: Annotated[int, typer.Option(help="seed of draws, noise and search")] = 0,
    stiffness: Annotated[
        float | None, typer.Option(help="stiffness of the trial runs [N·m/rad]; by default the joint's usual one")
    ] = None,
    dt: Annotated[float, typer.Option(help="sample time of the controller [s]")] = 0.01,
    horizon: Annotated[int, typer.Option(help="horizon of mpc, in samples")] = 20,
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
    """Tune a controller and its observer for a fitted plant, in closed loops with plants drawn from its posterior.

    Plants are drawn within the 95 % intervals of the file (table [intervals] of fit-motion), or within the usual errors
    of data sheets. The search minimises the 80 % quantile of the closed-loop cost over a sine, movements and steps,
    without and with a payload, and keeps M_s within its limit. `track`, `run` and `export` read the result from the
    file.
    """
    from rich.console import Console
    from rich.progress import track

    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.tuning.draws import Spreads
    from mpc.tuning.search import tune

    check_ending("--plot", plot, IMAGES)
    if in_place and out is not None:
        raise InvalidInput("--in-place and --out: give one of the two")
    copy = plant.with_name(plant.name + _KEPT) if in_place else None
    claim(out, plot, copy, inputs=(plant,), force=force)
    console = Console(stderr=as_json)
    model, known, spreads = Plant.load(plant), Compensation.load(plant), Spreads.load(plant)
    say(console, f"plant: {model.summary}" + f"; {known.summary}" * bool(known.summary))
    with _executor(workers, scheduler) as executor:
        tuned = tune(
            model, known, controller=controller, spreads=spreads, K=stiffness, peak=peak, evaluations=evaluations,
            n_draws=draws, seed=seed, dt=dt, horizon=horizon, executor=executor,
            progress=lambda found, total: track(found, "tuning", total, console=console, transient=True),
        )  # fmt: skip
    if as_json:
        print_json(tuned.to_dict())
    else:
        _describe(tuned, console)
    if copy is not None:
        copy.write_bytes(plant.read_bytes())
    target = plant if in_place else out
    if target is not None:
        tuned.save(plant, target)
        say(console, f"written: {target}" + f", with a copy of the file before in {copy}" * in_place)
    else:
        say(console, "not written: give --out FILE, or --in-place")
    if plot is not None:
        from allocator.presentation.plotting import save_figure
        from mpc.tuning.picture import plot_tuned

        save_figure(plot_tuned(tuned), plot, dpi=120)
        say(console, f"written: {plot}")


def _describe(tuned: "Tuned", console: "Console") -> None:
    """Print the figures before and after."""
    from rich.table import Table

    table = Table("", "before", "after", title=f"{tuned.tuning.controller}: 80 % quantiles over the draws")
    for row in tuned.rows():
        table.add_row(*row)
    console.print(table)
    say(console, tuned.tuning.summary)
    if tuned.warning:
        say(console, f"beware: {tuned.warning}")


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
    with ProcessPoolExecutor(count, initializer=_deaf) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _deaf() -> None:
    """Ignore interrupts, which the parent process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
