"""What the core need not know: a folder for each feature, found by `service.feature_folders`."""
