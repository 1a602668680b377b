"""The report of a finished run: what is measured for it, and what it shows."""
