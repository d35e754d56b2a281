"""What shows and measures the product: studies, benchmarks, the demo of several cells."""
