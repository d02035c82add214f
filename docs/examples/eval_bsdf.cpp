// Reads a pearl exported for `measured` (lut export --to bsdf-rgb) and evaluates it: f·cos θ of the light, linear sRGB.
//
//     c++ -std=c++17 -O2 eval_bsdf.cpp -o eval_bsdf
//     ./eval_bsdf pearl.bsdf  wix wiy wiz  wox woy woz
//
// Directions are in the local frame, z is the outward normal; wi looks at the surface, light arrives from wo.
// No library is needed; the machine is taken to be little-endian, as the file is.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

constexpr double PI = 3.14159265358979323846;

struct Tensor {
    std::vector<std::size_t> shape;
    std::vector<float> data;
};

template <class T> T take(const std::vector<char> &file, std::size_t &at) {
    T value;
    if (at + sizeof(T) > file.size()) throw std::runtime_error("the file ends too early");
    std::memcpy(&value, file.data() + at, sizeof(T));
    at += sizeof(T);
    return value;
}

// The fields of single precision, by name.
std::map<std::string, Tensor> read(const std::string &path) {
    std::ifstream stream(path, std::ios::binary);
    std::vector<char> file((std::istreambuf_iterator<char>(stream)), {});
    if (file.size() < 18 || std::memcmp(file.data(), "tensor_file", 12) != 0)
        throw std::runtime_error(path + " is not a tensor file; lut export --to bsdf-rgb writes one");
    std::map<std::string, Tensor> fields;
    std::size_t at = 14; // past the name and the version
    auto count = take<std::uint32_t>(file, at);
    for (std::uint32_t i = 0; i < count; ++i) {
        auto length = take<std::uint16_t>(file, at);
        std::string name(file.data() + at, length);
        at += length;
        auto dimensions = take<std::uint16_t>(file, at);
        auto type = take<std::uint8_t>(file, at);
        auto offset = take<std::uint64_t>(file, at);
        Tensor tensor;
        std::size_t size = 1;
        for (int d = 0; d < dimensions; ++d) {
            tensor.shape.push_back(take<std::uint64_t>(file, at));
            size *= tensor.shape.back();
        }
        if (type != 10) continue; // 10 is float
        if (offset + 4 * size > file.size()) throw std::runtime_error(name + " reaches past the end of the file");
        tensor.data.resize(size);
        std::memcpy(tensor.data.data(), file.data() + offset, 4 * size);
        fields[name] = tensor;
    }
    return fields;
}

// A place between two nodes.
struct Between {
    std::size_t low;
    double share;
};

Between cell(double u, std::size_t nodes) {
    double x = std::clamp(u, 0.0, 1.0) * double(nodes - 1);
    std::size_t low = std::min(std::size_t(x), nodes - 2);
    return {low, x - double(low)};
}

double mix(double a, double b, double share) { return a + (b - a) * share; }

// One slice of a tensor, [height][width], read bilinearly at (x, y) in the unit square.
double bilinear(const float *slice, std::size_t height, std::size_t width, double x, double y) {
    Between a = cell(x, width), b = cell(y, height);
    const float *row = slice + b.low * width + a.low;
    return mix(mix(row[0], row[1], a.share), mix(row[width], row[width + 1], a.share), b.share);
}

// The share of a slice's weight that lies below (x, y): first along the row, then over the rows.
struct Shares {
    double x, y;
};

Shares below(const float *slice, std::size_t height, std::size_t width, double x, double y) {
    Between a = cell(x, width), b = cell(y, height);
    std::vector<double> rows(height);
    double to_x[2] = {0, 0};
    for (std::size_t j = 0; j < height; ++j) {
        const float *row = slice + j * width;
        for (std::size_t i = 0; i + 1 < width; ++i) rows[j] += 0.5 * (row[i] + row[i + 1]);
        if (j == b.low || j == b.low + 1) {
            double &sum = to_x[j - b.low];
            for (std::size_t i = 0; i < a.low; ++i) sum += 0.5 * (row[i] + row[i + 1]);
            sum += a.share * (row[a.low] + 0.5 * a.share * (row[a.low + 1] - row[a.low]));
        }
    }
    double all = 0, until = 0;
    for (std::size_t j = 0; j + 1 < height; ++j) {
        double panel = 0.5 * (rows[j] + rows[j + 1]);
        if (j < b.low) until += panel;
        all += panel;
    }
    until += b.share * (rows[b.low] + 0.5 * b.share * (rows[b.low + 1] - rows[b.low]));
    return {mix(to_x[0], to_x[1], b.share) / mix(rows[b.low], rows[b.low + 1], b.share), until / all};
}

double of_theta(double theta) { return std::sqrt(theta * 2 / PI); }
double of_phi(double phi) {
    double u = (phi + PI) / (2 * PI);
    return u - std::floor(u);
}

int main(int count, char **arguments) try {
    if (count != 8) throw std::runtime_error("expected FILE and six numbers: wi, then wo");
    auto fields = read(arguments[1]);
    for (const char *name : {"theta_i", "ndf", "sigma", "vndf", "rgb"})
        if (!fields.count(name)) throw std::runtime_error(std::string(arguments[1]) + " has no field " + name);
    double wi[3], wo[3], m[3];
    for (int i = 0; i < 3; ++i) wi[i] = std::atof(arguments[2 + i]), wo[i] = std::atof(arguments[5 + i]);
    for (double *w : {wi, wo}) {
        double length = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
        for (int i = 0; i < 3; ++i) w[i] /= length;
    }
    if (wi[2] <= 0 || wo[2] <= 0) return std::puts("0 0 0"), 0;

    // The half vector, and where it and wi are in the file's squares.
    double length = 0;
    for (int i = 0; i < 3; ++i) m[i] = wi[i] + wo[i], length += m[i] * m[i];
    double theta_m = std::acos(std::min(1.0, m[2] / std::sqrt(length))), theta_i = std::acos(std::min(1.0, wi[2]));
    double phi_i = std::atan2(wi[1], wi[0]), phi_m = std::atan2(m[1], m[0]);
    double x = of_theta(theta_m), y = of_phi(phi_m - phi_i);

    // The two incidences around wi: the file interpolates linearly between them.
    const auto &thetas = fields["theta_i"].data;
    std::size_t next = std::upper_bound(thetas.begin(), thetas.end(), float(theta_i)) - thetas.begin();
    std::size_t low = std::clamp<std::size_t>(next, 1, thetas.size() - 1) - 1;
    double share = std::clamp((theta_i - thetas[low]) / (thetas[low + 1] - thetas[low]), 0.0, 1.0);

    const Tensor &warp = fields["vndf"]; // [1][incidence][height][width]
    std::size_t h = warp.shape[2], w = warp.shape[3];
    Shares a = below(&warp.data[low * h * w], h, w, x, y), b = below(&warp.data[(low + 1) * h * w], h, w, x, y);
    double sx = mix(a.x, b.x, share), sy = mix(a.y, b.y, share);

    const Tensor &ndf = fields["ndf"], &sigma = fields["sigma"], &rgb = fields["rgb"]; // rgb: [1][incidence][3][height][width]
    double jacobian = bilinear(ndf.data.data(), ndf.shape[0], ndf.shape[1], x, y) /
                      (4 * bilinear(sigma.data.data(), sigma.shape[0], sigma.shape[1], of_theta(theta_i), of_phi(phi_i)));
    std::size_t height = rgb.shape[3], width = rgb.shape[4], slice = height * width;
    for (int channel = 0; channel < 3; ++channel) {
        const float *here = &rgb.data[(low * 3 + channel) * slice], *there = here + 3 * slice;
        double value = mix(bilinear(here, height, width, sx, sy), bilinear(there, height, width, sx, sy), share);
        std::printf("%.6g%c", std::max(0.0, value * jacobian), channel < 2 ? ' ' : '\n');
    }
    return 0;
} catch (const std::exception &error) {
    std::fprintf(stderr, "eval_bsdf: %s\n", error.what());
    return 2;
}
