"""The light of drafts: sun, sky and what the ground sends back."""
