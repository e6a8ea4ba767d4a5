"""What Foxglove and Lichtblick show of a run: a scene in 3D, a layout of panels, a bench that is served live."""
