"""Bridges to other libraries: their environments as ours, and ours as theirs."""
