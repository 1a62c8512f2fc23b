"""Looking at a dataset and at the answers of methods: a recording for the viewer rerun, or a picture of one pair."""
