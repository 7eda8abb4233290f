"""Controllers against each other on joints that are not what their model says.

    python -m benchmarks.closed_loop [--quick] [--processes 2] [--out benchmarks/results]

Every controller gets the same model (Sarosi's muscles, nominal), the same knowledge of dead time, dead band and a share
of the friction, the same shaped and previewed references and the same limits. `pid` is what is usual: it differentiates
the encoder's angle; `predictive-pid` feeds back the angle and velocity that the MPC's observer and model predict for
the end of the dead time. The friction of the plant is Maxwell slip (`mpc.model.friction.maxwell_slip`), whose widths
follow P1 + P2 and which remembers where the joint turned round; controllers are told three quarters of Dahl's, which
follows the muscles' pull, with a loop as wide at one pressure. So no controller knows the truth. Plants with Dahl's
friction and with none are among the variants.

How fair it is. There is one tuning for everything, made on other seeds (from 101 on; reported are those from 41 on).
The PIDs' gains come from numerical optimisation (`benchmarks/closed_loop/tuning.py`) of this report's figures on the
very plant that is called standard. The MPC's numbers and the observer's were chosen by hand after a like search, on
four plants that rubbed by Dahl's law, and not again for this one; the LQR has the MPC's weights, with four times that
of the rate. That favours the PIDs on the standard plant. Elsewhere they pay for it. They are thrown off where friction,
which damps this joint, is absent and yet told of: what is added against it then drives the joint. Gentler gains hunt
there, or are thrown off too; told that there is none ("all but friction") a PID can be calm. The MPC, told the same
wrong thing, bears it. What gains do that are placed by the textbook instead of tuned is shown as well. A run in which
the joint was thrown off by more than 45° is called unstable and not given figures, which would say nothing about
tracking.

The load of 1 N·m that nobody tells them of comes half-way (in the stiffness step: at 0.5 s). Angle errors count from
the end of the first rest, in which the loop settles, to the load; "with load" to the end of the run. On the variants of
the standard plant controllers are told what they are told of the standard one. On plants with a single effect, and on
the one with all but friction, they are told what is true of that plant; what it costs to be told of effects that are
absent is shown for the nominal plant.

Written are `closed_loop.csv` (every run), `closed_loop_push.csv` (every push) and `closed_loop.md` (medians over the
seeds, against what was asked for). K errors are against the plant's true stiffness. Air is what was filled in after the
first rest: the rises of both pressures, summed [bar]; a muscle's volume times its part of that is the volume of air at
1 bar, but for what the muscle swells meanwhile. All of it takes about 10 minutes with two free processors; `--quick`
takes one seed of everything.
"""
