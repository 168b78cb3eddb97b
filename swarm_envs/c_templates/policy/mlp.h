/* Features into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    int j, k;
    @name@_own_features(self, own, values[0]);
    for (j = 0; j < @NAME@_NEIGHBOURS; j++) {
        float *x = values[0] + @own_width@ + j * @neighbour_width@;
        if (j < count)
            @name@_neighbour_features(self, own, &other[found[j]], x);
        else
            for (k = 0; k < @neighbour_width@; k++) x[k] = 0.0f;
    }
}

