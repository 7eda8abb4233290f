"""An arm of several joints, each held by a pair of muscles, fitted to its own log."""
