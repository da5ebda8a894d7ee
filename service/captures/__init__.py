"""Captures as people have them: cameras in one of several formats, with or without the photographs beside them."""
