"""Voxel blocks of a truncated signed distance field: fusion, storage, queries, meshes."""
