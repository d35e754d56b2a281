"""Views in a real Chromium; the services that they share end with the last of them."""
