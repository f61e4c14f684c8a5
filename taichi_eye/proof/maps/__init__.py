"""One module per map: where a method works, where it fails, and the theory of the border between."""
