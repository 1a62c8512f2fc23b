"""Houses of the town: their drawn parameters, fronts, roofs and attachments."""
