"""Arms are tried here: references, the closed loop with a plant on MuJoCo, figures, plots and films of a run."""

__all__: list[str] = []
