"""How fast: every figure is a ratio within one run, and nothing is timed before its answers are checked.

    python -m benchmarks.speed.exported  # the exported C against Python, a report of its own
    python -m benchmarks.speed [--light] [--part allocation] [--out benchmarks/results]

targets, rivals, c_reference → truth (aborts where two disagree) → clock → parts (`allocation`, `processes`, …) → report
"""
