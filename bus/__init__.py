"""What both sides share: the bus, its messages, vectors, errors. Which build runs is settled before all else."""

from bus import build as build
