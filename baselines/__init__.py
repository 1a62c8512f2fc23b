"""Methods that relocbench measures."""
