"""What all parts of the service mean alike: errors, requests, interfaces."""
