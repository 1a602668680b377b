"""Tools that show a run while it trains, told what `metrics.jsonl` is told."""
