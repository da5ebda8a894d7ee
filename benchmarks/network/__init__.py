"""Run time of the networks in each runtime and precision, relative to the machine's own matrix product."""
