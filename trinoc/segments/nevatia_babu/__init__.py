"""The chain of Nevatia and Babu, in the order of the work.

thinning -> chains -> runs -> line_fit -> accept -> errors, saturated_edges -> endpoints.
Source: R. Nevatia, K. R. Babu, "Linear feature extraction and description" (1980)."""
