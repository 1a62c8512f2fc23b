"""What the page of a set draws besides its tables: plan views, months apart, matching, basins and sweeps."""
