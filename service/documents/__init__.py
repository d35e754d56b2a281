"""Every REST answer and every message of the stream, once.

The model that builds an answer also publishes its schema: nothing is sent that is not described
here. A field that is left out of an answer where it means nothing is marked by `exclude_if`.
"""
