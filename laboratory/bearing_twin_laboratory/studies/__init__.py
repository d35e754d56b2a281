"""The paper's studies: tables with its figures next to ours, and plots as it draws them."""
