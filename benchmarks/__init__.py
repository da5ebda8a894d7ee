"""Speed measured side by side in one run, and what settings cost; not part of the package and not of the tests."""
