"""Controllers against each other on joints that are not what their model says.

    python -m benchmarks.closed_loop [--quick] [--processes 2] [--out benchmarks/results]

Every controller gets the same model (Sarosi's muscles, nominal), the same knowledge of dead time, dead band and a share
of the friction, the same shaped and previewed references and the same limits; one tuning for everything, made on other
seeds: the PIDs' by numerical optimisation (`benchmarks/closed_loop/tuning.py`), the MPC's by hand, after such a search.
The friction that is told has the form of the plant's (Dahl's, with the same presliding), so that the plant without it
matters as well. `pid` is what is usual: it differentiates the encoder's angle; `predictive-pid` feeds back the angle
and velocity that the MPC's observer and model predict for the end of the dead time.

The load of 1 N·m that nobody tells them of comes half-way (in the stiffness step: at 0.5 s). Angle errors count from
the end of the first rest, in which the loop settles, to the load; "with load" to the end of the run. On the variants of
the standard plant controllers are told what they are told of the standard one. On plants with a single effect they are
told what is true of that plant; what it costs to be told of effects that are absent is shown for the nominal plant.

Written are `closed_loop.csv` (every run), `closed_loop_push.csv` (every push) and `closed_loop.md` (medians over the
seeds, against what was asked for). K errors are against the plant's true stiffness. Air is what was filled in after the
first rest: the rises of both pressures, summed [bar]; a muscle's volume times its part of that is the volume of air at
1 bar, but for what the muscle swells meanwhile. All of it takes about 10 minutes with two processes; `--quick` takes
one seed of everything.
"""
