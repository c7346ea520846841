"""The topics: each runs its jobs in processes of their own and names the figures."""
