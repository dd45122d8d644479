"""The lens of one camera from several pictures of the sheet, with covariance and advice."""
