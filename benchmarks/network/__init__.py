"""How long the networks take, in each runtime and precision, beside the machine's own matrix product."""
