"""One drive registered against another, submap by submap."""
