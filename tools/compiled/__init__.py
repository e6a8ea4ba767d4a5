"""The compiled build: what is compiled, how, and how it gets in place. See docs/compiling.md."""
