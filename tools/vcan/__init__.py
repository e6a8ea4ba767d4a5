"""SocketCAN on any Linux: virtual interfaces where the kernel has CAN, else a guest kernel on the host's files."""
