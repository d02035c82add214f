"""The common grid of everything that depends on one angle alone (docs/ARRAYS.md): equal steps in u = √(1 − √cos θ)."""

STEPS = 1024
NODES = STEPS + 1
