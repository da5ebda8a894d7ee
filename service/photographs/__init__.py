"""gapmes.service.photographs: photographs from bytes to the network's grid, with their masks."""
