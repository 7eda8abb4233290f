"""The explorer is a page in the browser that shows what a joint can do, computed by `allocate` itself."""
