"""What the trainings of this repository share: log, checkpoint, batches in order, a step, where they ran."""
