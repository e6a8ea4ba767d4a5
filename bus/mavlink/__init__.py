"""MAVLink as both sides speak it: the dialect, a private datagram endpoint, and what every component does on a link."""
