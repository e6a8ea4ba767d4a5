"""The report of one or more runs as one HTML file that needs nothing else: no network, no server, no script."""
