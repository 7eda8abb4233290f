"""Command `antagonist explore`: a joint in the browser."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.shell.machine_options import MachineOptions
from allocator.shell.options import grouped, within
from allocator.shell.outputs import Force, check_ending, claim, say

if TYPE_CHECKING:
    from allocator import AntagonistJoint


@grouped
def explore(
    options: MachineOptions,
    run: Annotated[
        Path | None, typer.Option(help="a recorded run to play, the .npz of `antagonist track`; its joint is shown")
    ] = None,
    port: Annotated[int, typer.Option(help="port of the page's address; 0 takes a free one")] = 0,
    browser: Annotated[bool, typer.Option(help="open the browser")] = True,
    save: Annotated[
        Path | None, typer.Option(help="a .html to write instead: the page with its answers on a grid, to be shared")
    ] = None,
    force: Force = False,
) -> None:
    """Open a page in the browser with sliders for angle, stiffness, torque and the joint's dimensions.

    The page shows the feasible stiffnesses, the joint with its two muscles, their pressures, and the binding limit. It
    is served on this machine only and needs no internet. End it with Ctrl-C. With --save, a file holds the page. The
    torque is that of the muscles: add what balances gravity, which `allocate` prints.
    """
    import webbrowser
    from contextlib import suppress

    from rich.console import Console

    from mpc.explorer.server import HOST, frames, joint_run, server

    within("--port", port, "", 0, 65535)
    if run is not None and options != MachineOptions():
        raise InvalidInput("--run has its own joint: leave out the options of a joint")
    if save is not None:
        claim(save, inputs=(run, *options.files), force=force)
        check_ending("--save", save, (".html", ".htm"))
    joint = options.joint() if run is None else joint_run(run).plant.joint
    played = None if run is None else frames(run)
    if save is not None:
        _save(joint, played, save)
        return
    try:
        serving = server(joint, played, port)
    except OSError as error:
        raise InvalidInput(f"--port {port} cannot be used ({error.strerror}); 0 takes a free one") from None
    with serving:
        address = f"http://{HOST}:{serving.server_address[1]}/"
        say(Console(), f"the page is at {address} until Ctrl-C")
        if browser:
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            serving.serve_forever()


def _save(joint: "AntagonistJoint", played: dict[str, object] | None, out: Path) -> None:
    from functools import partial

    from rich.console import Console

    from allocator.presentation.progress import counted
    from mpc.explorer.server import saved_page

    page = saved_page(joint, played, partial(counted, title="answers"))
    write_text(out, page)
    say(Console(), f"written: {out}, a page for any browser")
