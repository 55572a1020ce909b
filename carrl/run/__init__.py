"""Training, evaluation and reports: where the parts are built and set in motion."""
