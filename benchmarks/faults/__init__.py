"""Faults of a joint, and whether its observer names them.

The loop is that of the closed-loop benchmark: MPC and observer with the nominal model of Sarosi's muscles, dead time,
dead band and a share of the friction told. Every fault comes at several moments, in the rest before the motion and in
the motion, and stays for the rest of the run, `AFTERWARDS` seconds at most. Without a fault nothing may be suspected,
whatever the trajectory, the plant (strength of the muscles, lag, friction that is told but absent) and the load that
nobody tells of.

Delays count from the onset, and from the first moment at which the fault makes a difference: a stuck valve that nobody
commands is none. A fault is named rightly if it alone is suspected, as one of a group if others are as well, and
wrongly if it is not among the suspects; counted at the alarm, and one second later (or at the end of the run).

Written are `faults.csv` (every run) and `faults.md`. All of it takes half an hour of one processor; `--quick` takes one
run of each fault and trajectory, `--share 0.2` a fifth of everything.
"""
