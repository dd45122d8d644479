"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours.

messages (who excludes whom; sum-product), junction_support (who meets whom in space) and repetition
(where wrong partners fit as well), of which the first two are joined in marginals."""
