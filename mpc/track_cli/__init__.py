"""Command `antagonist track`: a controller on a simulated joint or arm."""
