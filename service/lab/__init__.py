"""What shows and measures the product: studies, benchmarks, demo."""
