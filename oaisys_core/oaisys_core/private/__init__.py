"""Private parts of other libraries, one module each, and what is done without them.

What a library does not promise may be gone with its next version. Each module says which part it
uses, with which versions it was tried, the public way that is taken where the part is gone, and
what is lost then; docs/architecture.md lists them. Nothing here imports ``bpy``: those who use a
part of Blender pass in what is needed of it.
"""
