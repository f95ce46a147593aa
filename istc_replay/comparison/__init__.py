"""Two results side by side: what moved, who goes before whom, by how much."""
