"""Which points a campaign flies, and what it makes of the answers: all of a plan, until a rate is known, to a boundary."""
