"""The page's pure modules in Node.js, without a browser; what draws is in `tests/browser`."""
