"""The way from a bench to ground stations: a gateway between its private sockets and UDP on this machine."""
