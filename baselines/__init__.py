"""The methods that come with relocbench and are measured by it."""
