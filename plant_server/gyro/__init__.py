"""The gyro: presets of its noise, the noise itself, one axis, and the triad."""
