"""Makes the specification's schemas and tables, and the pages' options, from the code; no part of the runtime."""
