"""What the ground looks like in drafts: layers, masks, normals, water."""
