"""Whether poses can be those of a drive: jumps, outlier poses, holes, headings, and worlds that drives share."""
