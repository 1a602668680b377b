"""Which pose candidate explains a view best: hindsight loss and its shortcuts."""
