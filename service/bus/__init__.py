"""What joins the cell with the web side and the plant side: changes out, commands in."""
