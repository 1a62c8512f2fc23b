"""What a map knows of the depth of its keyframes: all of it, or as little and as well as real maps do."""
