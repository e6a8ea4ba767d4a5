"""A log flown again: what the flight software was given goes into the real flight software, and what it says is compared."""
