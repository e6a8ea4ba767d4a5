import bus.build  # noqa: F401  which build runs is settled before any module of ours is imported
