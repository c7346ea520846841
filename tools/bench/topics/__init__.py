"""What is measured: each topic has its jobs run in processes of their own and names the figures."""
