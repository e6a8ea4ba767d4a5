"""The wire between the two sides, and what can go wrong on it: the frames at the flight computer's connector."""
