"""The chain of Nevatia and Babu, in the order of the steps.

masks, thinning -> chains -> edge_points, runs -> line_fit -> side_slopes, accept -> neighbours,
saturated_edges -> errors -> endpoints. Source: R. Nevatia, K. R. Babu, "Linear feature extraction
and description" (1980).
"""
