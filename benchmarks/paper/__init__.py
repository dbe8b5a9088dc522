"""The paper's experiment: runs, tables, figures, and the pages written from them."""
