"""Speaking to a bench that runs: finding it, asking its plant, and making a scenario of what it was told."""
