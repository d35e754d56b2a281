"""The paper's studies: tables with its figures beside ours, and plots as it draws them."""
