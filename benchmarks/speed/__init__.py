"""Speed: every figure is a ratio within one run, and answers are checked before anything is timed.

    python -m benchmarks.speed.exported  # the exported C against Python, a report of its own
    python -m benchmarks.speed [--light] [--part allocation] [--out benchmarks/results]

targets, rivals, c_reference → truth (aborts where two disagree) → clock → parts (`allocation`, `processes`, …) → report
"""
