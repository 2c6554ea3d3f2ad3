"""What instruments and machines export, as records: raw folders, native formats, coupon records; what `inspect` finds in them."""
