"""Which depth a pixel has that no other view confirms: a small network chooses between candidates."""
