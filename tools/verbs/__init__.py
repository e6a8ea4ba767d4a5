"""The verbs of the `hilsat` command, one module a subject."""
