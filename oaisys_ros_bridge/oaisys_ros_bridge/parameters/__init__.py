"""Parameters and interfaces of all nodes as tables, and the page written from them."""
