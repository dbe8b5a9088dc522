"""What the default model is measured by beside its rates: variety, and what each ingredient brings."""
