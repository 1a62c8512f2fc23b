"""Registration of one drive against another, submap by submap."""
