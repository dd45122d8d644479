"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours.

messages (who excludes whom; sum-product) and junction_support (who meets whom in space), joined in
marginals."""
