
/* A vector over a length, cut there. */
static inline void @name@_cut(const float v[3], float reach, float *x)
{
    const float length = @name@_length(v);
    int k;
    for (k = 0; k < 3; k++) x[k] = v[k] / (length > reach ? length : reach);
}
